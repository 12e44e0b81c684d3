"""Tables 1 to 3 of NASA TM-101722 a second time, typed as they are printed: the paper's signs, its
mantissas and powers of ten.

Cells that the text read by machine has otherwise stand in ``MISREAD`` with the reason for what
stands here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

NAMES = (
    "alpha",
    "q",
    "delta",
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "L_0",
    "M_0",
    "delta_0",
)
# our pseudo-control is minus the paper's
TURNED = frozenset({"delta", "L_delta", "M_delta", "delta_0"})
ROWS = {
    "simulation": {
        "initial": "0 0 0 -.191e1 -.140e2 .130e-3 -.377e0 .101e1 -.368e1 .792e1 0 0 0",
        "final": (
            ".505e-2 -.171e-1 .706e-1 -.191e1 -.124e2 -.249e-4 -.317e0 .101e1 -.299e1 .106e2 "
            "-.486e-3 .187e-1 .783e0"
        ),
        "initial variance": (
            ".116e-5 .119e-5 .100e-3 .112e0 .536e1 .625e-3 .596e-2 .100e-1 .266e1 .156e1 .100e-3 "
            ".100e-1 .225e1"
        ),
        "final variance": (
            ".404e-9 .420e-7 .212e-4 .385e-5 .113e-1 .679e-9 .120e-4 .280e-6 .244e-2 .209e-1 "
            ".822e-9 .303e-5 .232e-2"
        ),
        "measurement noise": ".382e-3 .391e-3 .138e-5",
        "state noise": "0 .500e-4 0 0 0 0 0 0 0 0 0 0 0",
        "heading": "4.2596 0.5753",
    },
    "flight": {
        "initial": "0 0 0 -.191e1 -.124e2 -.249e-4 -.317e0 .101e1 -.299e1 .106e2 0 0 0",
        "final": (
            ".553e-2 -.611e-2 .261e-1 -.210e1 -.895e1 -.342e-4 -.367e0 .101e1 -.619e1 .146e2 "
            "-.690e-4 .944e-2 .402e0"
        ),
        "initial variance": (
            ".116e-5 .119e-5 .100e-3 .112e0 .536e1 .625e-3 .596e-2 .100e-1 .266e1 .156e1 .100e-3 "
            ".100e-1 .225e1"
        ),
        "final variance": (
            ".297e-8 .874e-7 .122e-4 .725e-4 .247e-1 .746e-8 .492e-4 .595e-5 .189e-1 .891e-1 "
            ".750e-8 .245e-5 .263e-2"
        ),
        "measurement noise": ".382e-2 .391e-2 .138e-4",
        "state noise": "0 .500e-4 0 0 0 0 0 0 0 0 0 0 0",
        "heading": "4.6965 0.8823",
    },
}
ROBUSTNESS = {  # from L_alpha on
    "time_shift": "-2.10 -8.42 -6.31e-4 -0.346 1.02 -5.76 16.8 2.34e-5 9.20e-3 4.62",
    "convergence": "-2.09 -8.31 -2.66e-5 -0.370 1.01 -5.36 19.1 -4.75e-5 -2.22e-3 -8.73e-2",
}
NOISY = {"alpha": "deg^2", "q": "(deg/s)^2", "nz": "g^2"}
# EKF from, to, frequency response
CHECKS = {"delay": ".140 .146 .120", "damping_ratio": ".84 .92 1.05"}
# The upper triangle row by row, from the diagonal on; the file has the lower one.
CORRELATION = {
    "simulation": """
        .15506 -.24955 .41331 .06827 -.32304 .08508 -.39590 .10736 .07459 .74554 -.17110 -.24041
        .05098 -.06954 .04102 .03762 -.07725 .03875 -.10829 -.03979 -.01686 .06768 .04516
        -.02653 -.00236 .11107 -.14909 .06080 -.12547 -.15092 -.34409 .96273 .98721
        .01610 -.48989 .08355 -.59820 .19205 .06850 .00178 -.04350 -.01579
        -.12624 .54708 -.09847 .34516 .73953 .01722 -.12007 .11690
        -.22689 .77509 -.21938 -.16148 -.07766 .14283 .08631
        -.17641 .92781 .84812 .07540 -.31789 -.01402
        -.20940 -.04785 -.05120 .08488 .05378
        .73248 .06831 -.28246 -.00877
        .07437 -.30871 .00863
        -.23452 -.33607
        .92405""",
    "flight": """
        .15520 .30339 .45422 .00249 -.32055 .02536 -.37004 .08520 .01546 .75852 .48553 .30227
        .01213 -.19339 .17469 .09181 -.08694 .11508 -.14395 -.02172 .03066 .03982 .00948
        .01650 .03627 -.02646 -.00437 -.02290 .00088 .02419 .38338 .92657 .99320
        -.15129 -.52764 .08438 -.62633 .23443 .06157 -.01968 .00016 .02351
        -.02030 .46982 .06861 .32570 .67047 -.03501 -.05660 .11401
        -.30411 .86501 -.34107 -.13320 -.02950 .00150 -.04172
        -.22896 .96893 .87585 -.04645 -.13821 .09768
        -.31818 .01716 -.01880 .00127 -.02069
        .81066 -.04257 -.12910 .09529
        -.04749 -.10711 .14043
        .62764 .37416
        .90518""",
}
MISREAD = {
    "simulation initial variance alpha": (
        "read as .116e-3; the flight's P0 is the simulation's, and Table 2 is whole"
    ),
    "simulation initial variance q": "read as .119e-3; likewise",
    "simulation final delta": "the text has 0.706 > 10-1",
    "simulation final L_delta": "not read; Table 3 and the start of Table 2 have -2.49e-5",
    "simulation state noise q": "the text has 0.500 < 10-4; Table 2 has 0.500 x 10^-4",
    "flight final variance q": "0.874 and 10^-7 are read as two cells",
    "simulation correlation delta, M_delta": (
        "read with both signs; with the other the matrix is not positive"
    ),
    "simulation correlation alpha, delta_0": "likewise",
    "flight correlation alpha, M_0": "likewise",
}


def numbers(row: str) -> list[Decimal]:
    """The numbers of a row."""
    return [Decimal(each) for each in row.split()]


def expected() -> dict[str, Decimal]:
    """Every number that ``scenarios/studies/published/short_period_dynamics.toml`` must hold, by
    dotted key.
    """
    out: dict[str, Decimal] = {}
    for column, rows in ROWS.items():
        cells = {kind: dict(zip(NAMES, numbers(row), strict=False)) for kind, row in rows.items()}
        for kind, table in (("final", "loes"), ("initial", "initial")):
            out |= {
                f"{table}.{column}.{name}.value": turned(name, value)
                for name, value in cells[kind].items()
            }
            out |= {
                f"{table}.{column}.{name}.variance": value
                for name, value in cells[f"{kind} variance"].items()
            }
        frequency, damping = numbers(rows["heading"])
        out |= {
            f"loes.{column}.natural_frequency.value": frequency,
            f"loes.{column}.damping_ratio.value": damping,
        }
        out |= {
            f"measurement_noise.{column}.{name}.value": v
            for name, v in zip(NOISY, numbers(rows["measurement noise"]), strict=True)
        }
        out |= {
            f"process_noise.{column}.{name}.value": v
            for name, v in cells["state noise"].items()
            if v
        }
        upper = [numbers(row) for row in CORRELATION[column].strip().splitlines()]
        out |= {
            f"correlation.{column}.{NAMES[i + 1 + j]}.{i}": value
            for i, row in enumerate(upper)
            for j, value in enumerate(row)
        }
    for column, row in ROBUSTNESS.items():
        out |= {
            f"loes.{column}.{name}.value": turned(name, value)
            for name, value in zip(NAMES[3:], numbers(row), strict=True)
        }
    for name, row in CHECKS.items():
        out |= {
            f"checks.flight.{name}.{key}": v
            for key, v in zip(("low", "high", "frequency_response"), numbers(row), strict=True)
        }
    return out


def turned(name: str, value: Decimal) -> Decimal:
    """A value with our sign of the pseudo-control."""
    return -value if name in TURNED else value


def leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Decimal]]:
    """Every number of a TOML table and its lists by dotted key."""
    for key, entry in table.items():
        if isinstance(entry, Mapping):
            yield from leaves(entry, f"{prefix}{key}.")
        elif isinstance(entry, Sequence) and not isinstance(entry, str):
            yield from ((f"{prefix}{key}.{i}", Decimal(value)) for i, value in enumerate(entry))
        elif isinstance(entry, Decimal | int):
            yield prefix + key, Decimal(entry)


def wrong(document: Mapping[str, Any]) -> list[str]:
    """Keys of the published file that lack, are too many or have another number, or another unit of
    R.
    """
    found, right = dict(leaves(document)), expected()
    units = [
        f"{column}.{name}"
        for column, rows in document["measurement_noise"].items()
        for name, row in rows.items()
        if row["unit"] != NOISY[name]
    ]
    return sorted(
        [key for key in found.keys() | right.keys() if found.get(key) != right.get(key)] + units
    )
