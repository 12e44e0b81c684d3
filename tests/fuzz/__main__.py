"""`python -m tests.fuzz [FIRST [LAST]]`: malformed calls by their numbers, those that end wrongly
printed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.cases import COUNT, KINDS, case
from tests.fuzz.judging import fault_of, files_in, run
from tests.fuzz.material import make_material


def main() -> None:
    """Run them, print each fault with the call, and how many there are."""
    first, last = (
        int(sys.argv[1]) if len(sys.argv) > 1 else 0,
        int(sys.argv[2]) if len(sys.argv) > 2 else COUNT,
    )
    wrong = 0
    with tempfile.TemporaryDirectory() as made:
        (Path(made) / "material").mkdir()
        material = make_material(Path(made) / "material")
        for number in range(first, last):
            folder = Path(made) / f"case{number}"
            folder.mkdir()
            arguments = case(number, material, folder)
            before, began = files_in(folder), time.monotonic()
            ended = run(arguments, folder)
            fault, took = fault_of(ended, folder, before), time.monotonic() - began
            if fault or last - first == 1:
                wrong += bool(fault)
                shown = " ".join(
                    repr(text) if len(text) < 60 else f"<{len(text)} characters>"
                    for text in arguments
                )
                print(
                    f"{number} {KINDS[number % len(KINDS)].__name__}: {fault} ({took:.1f} s)\n    "
                    f"{shown}\n    {ended.err[:600]!r}",
                    flush=True,
                )
    print(f"{wrong} of {last - first} end wrongly")


main()
