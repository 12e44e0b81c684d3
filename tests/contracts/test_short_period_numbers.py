"""Every number taken from NASA TM-101722: the published file, starts, P0, R and Q, held against a
second copy and against its text.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.identification.low_order import ENGINEERING_STD, PAPER_START
from scenarios.x29.declaration import (
    fly_loop,
    printed_column,
    printed_correlation,
    printed_density,
    printed_noise,
    printed_start,
)
from scenarios.x29.estimating import set_up
from scenarios.x29.study import loop_scenario
from tests.oracles.printed_tables import is_printed, lines_of, section
from tests.oracles.short_period_tables import (
    CORRELATION,
    MISREAD,
    NAMES,
    NOISY,
    ROBUSTNESS,
    ROWS,
    expected,
    numbers,
    wrong,
)

ROOT = Path(__file__).parents[2]
TEXT = ROOT.parent / "shared" / "seeds" / "000_56b834f8104b08bf.txt"
FILE, CATALOG = (
    ROOT / "scenarios/studies/published/short_period_dynamics.toml",
    ROOT / "scenarios/catalog",
)
# scenarios with the paper's R and Q
WITH_Q = ("simulation", "flight", "time-shift", "convergence", "final-peak")
WITH_R = (*WITH_Q, "innovations")
SAMPLE = 0.025  # s, of the paper's telemetry
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?(?![\w.])")
# whose P0 the paper's rule leaves to judgement
NEAR_ZERO = ("delta", "L_delta", "L_q", "L_0", "M_0", "delta_0")


def read(text: str) -> dict[str, Any]:
    return tomllib.loads(text, parse_float=Decimal)


def mutations(text: str, begin: int = 0) -> list[str]:
    """The text with one number changed at a time: a digit of it, and its sign where it has one;
    what is commented out stays.
    """
    out, line_start = [], begin
    for line in text[begin:].splitlines(keepends=True):
        for found in NUMBER.finditer(line.split("#")[0]):
            first, last = line_start + found.start(), line_start + found.end()
            digit = next(at for at in range(last - 1, first - 1, -1) if text[at].isdigit())
            out.append(f"{text[:digit]}{(int(text[digit]) + 1) % 10}{text[digit + 1 :]}")
            out += [text[:first] + text[first + 1 :]] if text[first] == "-" else []
        line_start += len(line)
    return out


def test_the_file_holds_what_the_second_copy_holds() -> None:
    assert wrong(read(FILE.read_text(encoding="utf-8"))) == []


@pytest.mark.long
def test_a_changed_number_sign_or_unit_anywhere_in_the_file_is_found() -> None:
    text = FILE.read_text(encoding="utf-8")
    right = expected()
    others = mutations(text)
    signs = sum(value < 0 for value in right.values())
    assert len(others) == len(right) + signs, "every number is tried"
    for other in others:
        assert len(wrong(read(other))) == 1
    assert len(wrong(read(text.replace('"deg^2"', '"rad^2"', 1)))) == 1


def wrong_settings(scenarios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Starts, R and Q of scenario files by name that are not the paper's."""
    right, out = expected(), []
    start = scenarios["simulation"]["estimate"]["start"]
    out += [
        f"start of {name}"
        for name in PAPER_START
        if name != "delay" and start[name] != right[f"initial.simulation.{name}.value"]
    ]
    for name in WITH_R:
        for output, unit in NOISY.items():
            number, given = scenarios[name]["flight"]["noise_variance"][output].split(" ", 1)
            same = (
                Decimal(number) == right[f"measurement_noise.flight.{output}.value"]
                and given == unit
            )
            out += [] if same else [f"{name}: R of {output}"]
    share = float(scenarios["simulation"]["estimate"]["noise_share"]) ** 2
    tenth = float(
        right["measurement_noise.simulation.q.value"] / right["measurement_noise.flight.q.value"]
    )
    out += [] if share == pytest.approx(tenth, rel=1e-9) else ["share of R"]
    Q = float(right["process_noise.flight.q.value"]) * SAMPLE
    return out + [
        f"{name}: Q"
        for name in WITH_Q
        if float(scenarios[name]["estimate"]["process_noise"]["q"]) != pytest.approx(Q)
    ]


def settings_text(name: str) -> str:
    return (CATALOG / f"x29-{name}.toml").read_text(encoding="utf-8")


def test_starts_r_and_q_of_the_scenarios_are_the_papers_and_a_change_is_found() -> None:
    texts = {name: settings_text(name) for name in WITH_R}
    scenarios = {name: read(text) for name, text in texts.items()}
    assert wrong_settings(scenarios) == []
    tried = 0
    for name, text in texts.items():
        places = ["noise_variance", *(["process_noise"] if name in WITH_Q else [])]
        places += ["noise_share", "[estimate.start]"] if name == "simulation" else []
        for place in places:
            begin = text.index(f"\n{place}") + 1  # as a key of a table, not in what is said of it
            end = len(text) if place.startswith("[") else text.index("\n", begin)
            for other in mutations(text[:end], begin):
                tried += 1
                assert len(wrong_settings({**scenarios, name: read(other + text[end:])})) == 1, (
                    other[begin:]
                )
    assert tried == 6 * 3 + 1 + 5 + 7 + 4, (
        "R of three outputs, its share, Q, seven starts, four of them negative"
    )


def test_constants_of_the_filter_are_the_papers() -> None:
    right = expected()
    for name, value in PAPER_START.items():
        assert value == (
            0.0 if name == "delay" else float(right[f"initial.simulation.{name}.value"])
        ), name
    for name in NEAR_ZERO:
        assert ENGINEERING_STD[name] ** 2 == pytest.approx(
            float(right[f"initial.simulation.{name}.variance"]), rel=1e-12
        ), name
    assert set(ENGINEERING_STD) == {*NEAR_ZERO, "nz_0"}, "P0 of nz_0 is printed nowhere"


@pytest.mark.parametrize("column", ROWS)
def test_readers_give_what_is_printed_in_si(column: str) -> None:
    right = {key: float(value) for key, value in expected().items()}
    for table, cells in (("loes", printed_column(column)), ("initial", printed_start(column))):
        for name in NAMES:
            cell = cells[name]
            assert cell.std is not None
            assert cell.value == right[f"{table}.{column}.{name}.value"]
            assert cell.std**2 == pytest.approx(right[f"{table}.{column}.{name}.variance"])
    radian = np.array([np.pi / 180.0, np.pi / 180.0, 1.0])
    found = [printed_noise(column)[name] for name in NOISY]
    assert found == pytest.approx(
        radian * np.sqrt([right[f"measurement_noise.{column}.{name}.value"] for name in NOISY])
    )
    assert printed_density(column) == {"q": 0.5e-4}
    names, C = printed_correlation(column)
    turned = [name in ("delta", "L_delta", "M_delta", "delta_0") for name in names]
    rows = [
        [float(each) for each in numbers(row)] for row in CORRELATION[column].strip().splitlines()
    ]
    for i, row in enumerate(rows):
        for j, value in enumerate(row, start=i + 1):
            assert C[i, j] == C[j, i] == (-value if turned[i] != turned[j] else value)
    assert np.linalg.eigvalsh(C)[0] > -1e-5, "five digits of a matrix that is singular to rounding"


def test_the_paper_carries_its_p0_over_and_ours_is_of_the_new_start() -> None:
    scenario = loop_scenario("x29-flight", ["flight.duration=6", "estimate.window_stop=6"])
    flown = fly_loop(scenario.flight, 1)
    start = {name: 1.1 * value for name, value in PAPER_START.items() if name != "delay"}
    right = {key: float(value) for key, value in expected().items()}
    paper, ours = (
        set_up(scenario.estimation, flown, start, prior=prior).system
        for prior in ("printed", "quarter")
    )
    for name in NAMES:
        item = paper.initial[name] if name in paper.state_names else paper.parameters[name]
        assert item.prior_std**2 == pytest.approx(right[f"initial.simulation.{name}.variance"]), (
            name
        )
        assert (
            right[f"initial.simulation.{name}.variance"] == right[f"initial.flight.{name}.variance"]
        ), name
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        assert ours.parameters[name].prior_std == pytest.approx(abs(start[name]) / 4.0), name


@pytest.fixture(scope="module")
def text() -> str:
    if not TEXT.is_file():
        pytest.skip("the paper's text is not here")
    return TEXT.read_text(encoding="utf-8")


# How the lines of a row begin in the text, where a row of Table 1 is broken over two lines.
LINES = {
    "initial": ("Initial state", "estimate"),
    "final": ("Final state", "estimate"),
    "initial variance": ("Initial variance",),
    "final variance": ("Final variance",),
    "measurement noise": ("Measurement", "noise variance"),
    "state noise": ("State noise",),
}


def unread(rows: Mapping[str, Mapping[str, str]], text: str) -> list[str]:
    """Rows of the second copy that the text has not in this order, zeros and misread cells left
    out; the tables are printed in two halves.
    """
    out = []
    for column, mark in (("simulation", "Table 1. "), ("flight", "Table 2. ")):
        table = section(text, f"{mark}Output", f"{mark}Con")
        out += (
            []
            if is_printed(numbers(rows[column]["heading"]), table.splitlines()[0])
            else [f"{column} heading"]
        )
        for kind, begins in LINES.items():
            cells = dict(
                zip(
                    NOISY if kind == "measurement noise" else NAMES,
                    numbers(rows[column][kind]),
                    strict=True,
                )
            )
            kept = {
                name: value
                for name, value in cells.items()
                if value and f"{column} {kind} {name}" not in MISREAD
            }
            half = ("alpha", "q") if kind == "measurement noise" else NAMES[:7]
            parts = [
                [v for n, v in kept.items() if n in half],
                [v for n, v in kept.items() if n not in half],
            ]
            out += [
                f"{column} {kind}"
                for part in parts
                if part and not is_printed(part, lines_of(table, *begins))
            ]
    return out


def unread_correlations(column: str, rows: str, text: str) -> list[int]:
    """Rows of a correlation matrix's upper triangle that the text has not in this order, misread
    cells left out.
    """
    begin, end = {
        "simulation": ("Table 1. Concluded", "Table 2. Output"),
        "flight": ("Table 2. Concluded", "Table 3."),
    }[column]
    table, out = section(text, begin, end), []
    for i, row in enumerate(rows.strip().splitlines()):
        pairs = zip(NAMES[i + 1 :], numbers(row), strict=True)
        kept = [
            value
            for name, value in pairs
            if f"{column} correlation {NAMES[i]}, {name}" not in MISREAD
        ]
        out += [] if is_printed(kept, table) else [i]
    return out


def test_the_second_copy_stands_in_the_papers_text(text: str) -> None:
    assert unread(ROWS, text) == []
    for column, rows in CORRELATION.items():
        assert unread_correlations(column, rows, text) == []
        for i, row in enumerate(rows.strip().splitlines()):
            first = row.split()[0]
            other = f"{first[:-1]}{(int(first[-1]) + 1) % 10}"
            assert i in unread_correlations(column, rows.replace(first, other, 1), text), first
    robustness = section(text, "Table 3. Robustness", "Fig. 1 ")
    for column, begin in (("time_shift", "Time shift"), ("convergence", "Convergence")):
        assert is_printed(numbers(ROBUSTNESS[column]), lines_of(robustness, begin))
    told = " ".join(text.split())
    for phrase in (
        "between 140 msec and 146 msec",
        "a time delay of 120 msec",
        "EKF estimated 0.84 to 0.92",
        "analysis estimated 1.05",
    ):
        assert phrase in told


@pytest.mark.parametrize(
    ("column", "kind"), [(column, kind) for column, rows in ROWS.items() for kind in rows]
)
def test_a_changed_number_of_the_second_copy_is_not_in_the_text(
    column: str, kind: str, text: str
) -> None:
    cells = ROWS[column][kind].split()
    names = {"heading": ("frequency", "damping"), "measurement noise": tuple(NOISY)}.get(
        kind, NAMES
    )
    for at, (name, cell) in enumerate(zip(names, cells, strict=True)):
        if cell != "0" and f"{column} {kind} {name}" not in MISREAD:
            other = [
                *cells[:at],
                str(Decimal(cell) + Decimal(1).scaleb(Decimal(cell).as_tuple().exponent)),  # type: ignore[arg-type]
                *cells[at + 1 :],
            ]
            assert unread({**ROWS, column: {**ROWS[column], kind: " ".join(other)}}, text) == [
                f"{column} {kind}"
            ], cell
