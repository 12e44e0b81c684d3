"""A sweep flown, its response, model and margins estimated, and all of them against the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.estimate import Estimate, Outcome
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.preparation.plan import Request
from scenarios.report.document import (
    Block,
    Bullets,
    Page,
    Prose,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures as figure_blocks
from scenarios.report.folder import write_page
from scenarios.report.quantities import console, number_text
from scenarios.report.shared_tables import estimates_table
from scenarios.report.summary import BELOW, Summary, print_summary
from scenarios.report.terminal import show_blocks, show_table
from scenarios.report.text_tables import print_paragraph
from scenarios.responses.analysis import ResponseEstimates, ResponseOptions, responses_of
from scenarios.responses.fitting import FitOptions
from scenarios.responses.loops import MINUS, UNITS, loop_tables, margin_lines, margins_content
from scenarios.responses.reading import Names
from scenarios.responses.report import fit_lines, fit_tables, responses_csv
from scenarios.studies.comparison import SCHEMA, estimate_content
from scenarios.studies.rows import Row
from scenarios.trials.sweeps.flight import SweepScenario, fly_sweep, true_margins, true_parameters
from sim.record import Record

if TYPE_CHECKING:
    from rich.console import Console

MAIN = "comparison.json"


@dataclass(frozen=True, eq=False)
class SweepStudy:
    """A sweep that has been flown.

    Attributes
    ----------
    records : of the flights. response : of the rate to the command, with the fitted form; None
    where
        none is fitted. loop : of the returned signal to the command, with its margins.
    rows : what was estimated, with the truth.
    """

    scenario: SweepScenario
    seed: int
    records: tuple[Record, ...]
    response: ResponseEstimates | None
    loop: ResponseEstimates
    rows: tuple[Row, ...]
    estimate: Estimate

    @property
    def record(self) -> Record:
        """The first flight."""
        return self.records[0]


def run_sweep(
    scenario: SweepScenario,
    seed: int | None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> SweepStudy:
    """Fly and estimate as ``flightid response`` does from the files of the flights; the same seed
    gives the same numbers.

    Raises
    ------
    FlightidError : a loop that is unstable, a band that the flights do not resolve.
    """
    chosen = scenario.seed if seed is None else seed
    rng = np.random.default_rng(chosen)
    records = tuple(fly_sweep(scenario, rng, n) for n in range(1, scenario.flights + 1))
    progress("flown", 0.3)
    with TemporaryDirectory(prefix="flightid-") as folder:
        paths = tuple(
            write_record(Path(folder), record, f"flight{n}", simulated=True)[0]
            for n, record in enumerate(records, 1)
        )
        request, options = Request(paths), ResponseOptions(scenario.band)
        response = None
        if scenario.form:
            names = Names(("command",), (records[0].output_names[1],), ("sweep",))
            response = responses_of(request, names, options, FitOptions((scenario.form,)))
        progress("response", 0.6)
        loop = responses_of(
            request, Names(("command",), ("returned",), ("sweep",)), options, margins=MINUS
        )
    rows, estimate = _estimated(scenario, response, loop)
    return SweepStudy(scenario, chosen, records, response, loop, rows, estimate)


def _estimated(
    scenario: SweepScenario, response: ResponseEstimates | None, loop: ResponseEstimates
) -> tuple[tuple[Row, ...], Estimate]:
    """Parameters of the fitted form and the margins, with the truth, and as an estimate."""
    true: Mapping[str, float] = {**true_parameters(scenario), **true_margins(scenario)}
    rows, covariance = [], np.zeros((0, 0))
    fitted = response.fits.of(0, 0) if response is not None and response.fits is not None else None
    if fitted is not None:
        function, _ = fitted
        covariance = np.asarray(function.covariance)
        for name, std in function.std.items():
            unit = {"gain": "rad/s2"}.get(name, function.form.units.get(name, ""))
            rows.append(Row(name, unit, function.values[name], std, true.get(name)))
    margins = loop.loop.margins.named if loop.loop is not None else {}
    for name, margin in margins.items():
        unit = UNITS[margin.kind].replace("-", "1")
        rows.append(Row(name, unit, margin.size.value, margin.size.std, true.get(name)))
    size, first = len(rows), len(covariance)
    whole = np.diag([row.std**2 for row in rows])
    whole[:first, :first] = covariance
    names, units = tuple(row.name for row in rows), tuple(row.unit for row in rows)
    values = np.array([row.estimate for row in rows]).reshape(size)
    none = np.zeros(0)
    return tuple(rows), Estimate(
        "frequency-response", names, units, values, whole, Outcome.CONVERGED, 0.0, (), none, ()
    )


def print_sweep(study: SweepStudy, out: Console | None = None, details: str = BELOW) -> None:
    """Print a study: what was estimated against the truth, the model, the margins."""
    out = out or console()
    print_summary(out, sweep_summary(study, details))
    show_table(out, estimates_table("Against the truth", study.rows))
    for line in model_lines(study):
        print_paragraph(out, line, indent=0)
    loop = study.loop.loop
    if loop is not None:
        show_blocks(out, loop_tables(loop))
        for line in margin_lines(loop):
            print_paragraph(out, line, indent=0)
    for line in cautions(study):
        print_paragraph(out, f"warning: {line}", indent=0)


def sweep_summary(study: SweepStudy, details: str) -> Summary:
    """What was flown, what came of it."""
    s = study.scenario
    flown = (
        f"{s.flights} flight{'s' * (s.flights > 1)} of {s.duration:g} s, a sweep of the command "
        f"from {s.low:g} to {s.high:g} Hz"
    )
    inside = sum(abs(row.sigmas) <= 2.0 for row in study.rows if row.sigmas is not None)
    known = sum(row.sigmas is not None for row in study.rows)
    shown = [row for row in study.rows if row.name in ("gain_increase", "phase_margin")]
    margins = "; ".join(
        f"{row.name.replace('_', ' ')} {number_text(row.estimate, row.std)} {row.unit}"
        for row in shown
    )
    return Summary(
        f"{s.name}: {flown}",
        f"{inside} of {known} true values within two sigmas",
        margins,
        details=details,
    )


def model_lines(study: SweepStudy) -> list[str]:
    """The fitted transfer function and how it is judged."""
    return [] if study.response is None else fit_lines(study.response, 0, 0)


def cautions(study: SweepStudy) -> tuple[str, ...]:
    """What a user should know of the estimates."""
    both = (*(study.response.cautions if study.response is not None else ()), *study.loop.cautions)
    return tuple(dict.fromkeys(both))


def write_sweep(study: SweepStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, responses, figures, the page, ``truth.json`` and ``comparison.json``
    (last).
    """
    with study_folder(folder, MAIN) as scratch:
        for n, record in enumerate(study.records, 1):
            write_record(scratch, record, "record" if n == 1 else f"record_{n}", simulated=True)
        both = [each for each in (study.response, study.loop) if each is not None]
        heads = [responses_csv(each).partition("\n") for each in both]
        write_text(
            scratch / "responses.csv", heads[0][0] + "\n" + "".join(rest for _, _, rest in heads)
        )
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import drawn_for_page
            from scenarios.plots.low_order import figure_margins, figure_mismatch, figure_response

            named: list[tuple[str, Any]] = [
                ("response", partial(figure_response, study.response or study.loop))
            ]
            if study.response is not None:
                named.append(("mismatch", partial(figure_mismatch, study.response)))
            named.append(("loop", partial(figure_margins, study.loop)))
            drawn = drawn_for_page(named, scratch, figures)
        write_page(scratch, sweep_page(study, drawn))
        write_json(scratch / "truth.json", truth_content(study))
        write_json(scratch / MAIN, sweep_comparison(study))
    return Path(folder)


def truth_content(study: SweepStudy) -> dict[str, Any]:
    """True parameters and margins."""
    known = {
        row.name: {"value": row.true, "unit": row.unit}
        for row in study.rows
        if row.true is not None
    }
    return {"schema": "flightid/truth/1", "parameters": known, "distance": study.scenario.distance}


def sweep_comparison(study: SweepStudy) -> dict[str, Any]:
    """Content of ``comparison.json``."""
    scenario, loop = study.scenario, study.loop.loop
    return {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": study.seed,
        "distance": scenario.distance,
        **estimate_content(study.estimate, study.rows, {}, {}, ()),
        **({"margins": margins_content(loop)} if loop is not None else {}),
        "warnings": list(cautions(study)),
        "versions": versions(),
    }


def sweep_page(study: SweepStudy, drawn: tuple[Drawn, ...]) -> Page:
    """The page of a study."""
    scenario, loop = study.scenario, study.loop.loop
    summary = sweep_summary(study, BELOW)
    margins: list[Block] = []
    if loop is not None:
        margins += loop_tables(loop)
        margins.append(Bullets(tuple(map(as_sentence, margin_lines(loop)))))
    model: list[Block] = [Prose(line) for line in model_lines(study)]
    if study.response is not None:
        model += fit_tables(study.response, 0, 0, "Parameters")
    return Page(
        title=capital(scenario.title),
        kind=f"Study {scenario.name}: frequency response, model and margins of a loop",
        verdict="estimated",
        tone="good",
        sentence=as_sentence(summary.outcome),
        summary=(as_sentence(summary.result),),
        warnings=tuple(map(as_sentence, cautions(study))),
        sections=(
            *section("Figures", *figure_blocks(drawn)),
            *section("Against the truth", estimates_table("Parameters and margins", study.rows)),
            *section("Transfer function", *model),
            *section("Stability margins", *margins),
            *section(
                "What was flown",
                Prose(scenario.about),
                Prose(f"Truth and model: {scenario.distance}.", "note"),
            ),
        ),
        reproduction=reproduction(
            ("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}.", []
        ),
        created=now(),
    )
