"""Coverage of every estimator: ``python -m exam coverage-estimators ROWS.jsonl``.

Each cell is an estimator, a model and a kind of noise. Its flights come from
`independent_flights` and are identified as a user would: from a CSV file and a vehicle file,
from derivatives that are up to 30 % wrong. Every run is one line of the file, so that a campaign
that was stopped goes on where it ended. ``--page`` writes the table into a page between two
marks.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exam.coverage.independent_flights import MODELS, NOISES, Flight, flown
from exam.options import Parser
from ident.statistics.intervals import clopper_pearson, clustered_share
from scenarios.identification.identify import identify_files
from scenarios.preparation.plan import Plan, Request
from sim.errors import FlightidError
from sim.record import Hold

ESTIMATORS = ("output-error", "filter-error", "equation-error", "frequency-domain", "ekf", "ukf")
LOW, HIGH = 0.93, 0.97  # acceptable two-sigma coverage
BEGIN, END = "<!-- coverage table: begin -->", "<!-- coverage table: end -->"
Cell = tuple[str, str, str]


def cells(wanted: Sequence[str] = ()) -> list[Cell]:
    """All cells, or those that contain every word of one of ``wanted`` (``"ekf,rigid,white"``;
    words left out stand for any).
    """
    every = [
        (estimator, model, noise)
        for noise in NOISES
        for model in MODELS
        for estimator in ESTIMATORS
        if (estimator, model) != ("frequency-domain", "longitudinal")  # not linear: refused
    ]
    if not wanted:
        return every
    asked = [set(each.split(",")) for each in wanted]
    return [cell for cell in every if any(words <= set(cell) for words in asked)]


def run_of(cell: Cell, run: int) -> dict[str, Any]:
    """One flight of a cell, identified: errors in sigmas by parameter, outcome, caution on
    sigmas.
    """
    estimator, model, noise = cell
    flight = flown(model, noise, run)
    row = {"estimator": estimator, "model": model, "noise": noise, "run": run}
    with tempfile.TemporaryDirectory() as folder:
        record, vehicle = write_flight(Path(folder), flight)
        plan = Plan(hold=Hold.PREVIOUS)
        request = Request((record,), model, vehicle, plan=plan)
        try:
            found = identify_files(request, estimator).found
        except FlightidError as error:
            return {**row, "outcome": "refused", "message": str(error)[:200], "errors": {}}
    estimate = found.estimate
    errors: dict[str, float] = {}
    for name, value in flight.true.items():
        if name in estimate.names and estimate.sigma(name) > 0.0:
            errors[name] = round((estimate.value(name) - value) / estimate.sigma(name), 4)
    cautioned = any("too small" in each for each in found.cautions)
    return {**row, "outcome": estimate.outcome.code, "cautioned": cautioned, "errors": errors}


def write_flight(folder: Path, flight: Flight) -> tuple[Path, Path]:
    """The flight as ``record.csv`` and ``vehicle.toml``, as a user has them."""
    record, vehicle = folder / "record.csv", folder / "vehicle.toml"
    header, columns = ",".join(flight.columns), np.array(list(flight.columns.values())).T
    np.savetxt(record, columns, delimiter=",", header=header, comments="", fmt="%.12g")
    lines = [f"{name} = {json.dumps(value)}" for name, value in flight.vehicle.items()]
    lines += ["[derivatives]", *(f"{name} = {value!r}" for name, value in flight.start.items())]
    vehicle.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return record, vehicle


def measure(rows: Path, wanted: Sequence[Cell], runs: int, first: int = 0) -> None:
    """Append every run that the file does not hold yet, all cells advancing together."""
    kept = {
        (each["estimator"], each["model"], each["noise"], each["run"]) for each in read_rows(rows)
    }
    for run in range(first, first + runs):
        for cell in wanted:
            if (*cell, run) not in kept:
                with rows.open("a", encoding="utf-8", newline="\n") as out:
                    out.write(json.dumps(run_of(cell, run)) + "\n")


def read_rows(rows: Path) -> list[dict[str, Any]]:
    """The runs that a file holds; none where there is no file."""
    return (
        [json.loads(line) for line in rows.read_text(encoding="utf-8").splitlines()]
        if rows.is_file()
        else []
    )


def statistics(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Coverage of one cell's settled runs, all parameters together, and its interval.

    Parameters of one run are not independent: the interval is one over runs drawn again
    (`ident.statistics.intervals`). ``worst``: the parameter that is covered least, with Clopper and
    Pearson's interval. ``bias``: the largest mean error of a parameter, in sigmas. ``scale``: the
    factor by which sigmas would have to be larger to hold 95.4 % of the errors.
    """
    every = list(rows)
    settled = [
        each for each in every if each["errors"] and each["outcome"] in ("converged", "at-bound")
    ]
    base = {
        "runs": len(every),
        "settled": len(settled),
        "cautioned": sum(bool(each.get("cautioned")) for each in settled),
    }
    if not settled:
        return base
    names = list(settled[0]["errors"])
    errors = np.array([[each["errors"].get(name, np.nan) for name in names] for each in settled])
    inside = np.abs(errors) <= 2.0
    low, high = clustered_share(
        inside.sum(axis=1), np.full(len(inside), inside.shape[1]), np.random.default_rng(0)
    )
    by_name = inside.mean(axis=0)
    worst = int(np.argmin(by_name))
    return {
        **base,
        "share": float(inside.mean()),
        "low": low,
        "high": high,
        "worst": names[worst],
        "worst_share": float(by_name[worst]),
        "worst_interval": clopper_pearson(float(inside[:, worst].sum()), len(settled)),
        "bias": float(np.max(np.abs(np.mean(errors, axis=0)))),
        "scale": float(np.quantile(np.abs(errors), 0.9545) / 2.0),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The measured cells as a table of Markdown."""
    head = (
        "| noise | model | estimator | runs | settled | within 2 sigma | 95 % interval | least | "
        "largest mean error | cautioned |\n"
    )
    lines = [head, "|---|---|---|---|---|---|---|---|---|---|\n"]
    for estimator, model, noise in cells():
        mine = [
            each
            for each in rows
            if (each["estimator"], each["model"], each["noise"]) == (estimator, model, noise)
        ]
        if not mine:
            continue
        s = statistics(mine)
        start = f"| {noise} | {model} | {estimator} | {s['runs']} | {s['settled']} |"
        if "share" not in s:
            lines.append(f"{start} - | - | - | - | - |\n")
            continue
        low, high = s["worst_interval"]
        least = f"{s['worst']} {100 * s['worst_share']:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        held = f"{100 * s['share']:.1f} % | {100 * s['low']:.1f} to {100 * s['high']:.1f} %"
        cautioned = f"{100 * s['cautioned'] / s['settled']:.0f} %"
        lines.append(f"{start} {held} | {least} | {s['bias']:.2f} sigma | {cautioned} |\n")
    return "".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked and print or write the table; 2 with one line where that fails."""
    parser = Parser("coverage-estimators", "coverage of every estimator")
    parser.add_argument(
        "rows", type=Path, help="file of runs, one a line; what it holds is not run again"
    )
    parser.add_argument(
        "--runs",
        type=int,
        default=0,
        help="runs of each cell (default: none, the table of what is there)",
    )
    parser.add_argument("--first", type=int, default=0, help="number of the first run")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="WORDS",
        help="cells with all these words, e.g. ekf,lateral",
    )
    parser.add_argument(
        "--page", type=Path, help="write the table into this page between its marks"
    )
    asked = parser.parse_args(arguments)
    try:
        measure(asked.rows, cells(asked.only), asked.runs, asked.first)
        found = table(read_rows(asked.rows))
        if asked.page is None:
            print(found, end="")
            return 0
        text = asked.page.read_text(encoding="utf-8")
        if BEGIN not in text or END not in text:
            raise ValueError(f"{asked.page} has no marks {BEGIN} and {END}")
        before, after = text.split(BEGIN, 1)[0], text.split(END, 1)[1]
        asked.page.write_text(
            f"{before}{BEGIN}\n\n{found}\n{END}{after}", encoding="utf-8", newline="\n"
        )
    except (OSError, ValueError) as error:
        print(f"python -m exam coverage-estimators: {error}", file=sys.stderr)
        return 2
    return 0
