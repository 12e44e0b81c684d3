"""Cases of causes that lie outside the library of effects, for the examiner.

python -m tests.independent.foreign OUT --cause fuel-slosh buffet --size medium --vehicle jet
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tests.independent.folders import Recording
from tests.independent.foreign.catalogue import CAUSES, SIZES, cases, write_case
from tests.independent.foreign.rigid_fit import seen_beside_rigid
from tests.independent.short_period import VEHICLES


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.independent.foreign",
        description=__doc__.splitlines()[0] if __doc__ else None,
    )
    parser.add_argument("out", type=Path, help="the folder that receives the cases")
    parser.add_argument("--cause", nargs="+", choices=list(CAUSES), default=list(CAUSES))
    parser.add_argument("--size", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument(
        "--vehicle",
        nargs="+",
        choices=list(VEHICLES),
        default=[],
        help="each case with all of these; else one each in turn",
    )
    parser.add_argument(
        "--rate", type=float, help="samples a second of all; else 50, and 25 or 100 of one in five"
    )
    parser.add_argument("--channels", nargs="+", default=["alpha", "q", "nz"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--measure",
        action="store_true",
        help="write nothing; print what the best rigid model leaves over of each case",
    )
    given = parser.parse_args(arguments)
    for case in cases(given.cause, given.size, given.vehicle):
        if given.measure:
            left = seen_beside_rigid(case, given.seed)
            shown = (
                f"{name} {sigmas:5.1f} sigma {100.0 * part:4.0f} %"
                for name, (sigmas, part) in left.items()
            )
            print(f"{case.folder:36}", "  ".join(shown), flush=True)
        else:
            how = Recording(rate=given.rate or case.rate, channels=tuple(given.channels))
            print(write_case(given.out, case, how, given.seed).name, flush=True)


if __name__ == "__main__":
    main()
