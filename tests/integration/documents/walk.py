"""Follows a page as its reader does, with the installed program and a stopwatch: `python -m
tests.integration.documents.walk PAGE --with PROGRAM`.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.integration.documents.snippets import ROOT, Reader


class Installed:
    """The program as a process; prints each call with the seconds that it took."""

    def __init__(self, program: str) -> None:
        self._program = program

    def _called(self, arguments: tuple[str, ...], code: int) -> subprocess.CompletedProcess[str]:
        begin = time.monotonic()
        call = subprocess.run(
            [self._program, *arguments],
            capture_output=True,
            text=True,
            encoding="utf-8",
            check=False,
        )
        print(f"{time.monotonic() - begin:6.1f} s  flightid {' '.join(arguments)}", file=sys.stderr)
        if call.returncode != code:
            sys.exit(f"exit code {call.returncode} in place of {code}:\n{call.stdout}{call.stderr}")
        return call

    def done(self, *arguments: str) -> str:
        return self._called(arguments, 0).stdout

    def refused(self, *arguments: str) -> str:
        return self._called(arguments, 2).stderr


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path, help="a Markdown page of the checkout")
    parser.add_argument(
        "--with",
        dest="program",
        default="flightid",
        help="the program; flightid on the search path",
    )
    given = parser.parse_args()
    # Tables are as wide as where the pages were written.
    os.environ.update(COLUMNS="120", NO_COLOR="1")
    page, program = (
        given.page.resolve(),
        os.path.abspath(given.program) if os.sep in given.program else given.program,
    )
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name in ("docs", "labs"):
            Path(name).symlink_to(ROOT / name)
        reader = Reader(Installed(program))
        reader.follow(page)
    if not reader.lines:
        sys.exit(f"{given.page} shows nothing that could be compared")
    print(
        f"{time.monotonic() - begin:6.1f} s  in all; {reader.lines} lines of the page are in what "
        "was printed",
        file=sys.stderr,
    )


if __name__ == "__main__":
    main()
