"""Sweeps of a loop with known response and margins: simulate, estimate, compare.

`flightid response` estimates response and margins from records of the loop under a sweep of its
command. A new scenario is a file in `catalog` with ``kind = "sweep"``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ident.estimate import Estimate, Outcome
from scenarios.files.declarations import checked
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.plots import draw_into
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
from scenarios.report.summary import BELOW, Summary, print_paragraph, print_summary
from scenarios.report.terminal import estimates_table, show_blocks, show_table
from scenarios.responses.analysis import ResponseEstimates, ResponseOptions, responses_of
from scenarios.responses.fitting import FitOptions
from scenarios.responses.loops import MINUS, UNITS, loop_tables, margin_lines, margins_content
from scenarios.responses.reading import Names
from scenarios.responses.report import fit_lines, fit_tables, responses_csv
from scenarios.studies.comparison import SCHEMA, distance_text, estimate_content
from scenarios.studies.declaration import Row
from scenarios.studies.schema import Quantity, Strict, positive, positive_si, si
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import LoopNoise, loop_test, open_loop
from sim.errors import DeclarationError
from sim.maneuvers import Spacing, Sweep
from sim.record import Channel, Hold, Record

if TYPE_CHECKING:
    from rich.console import Console

    from scenarios.plots.drawing import Named

MOST_SAMPLES = 200_000  # over all flights


@dataclass(frozen=True)
class RollLoop:
    """The roll axis of a small aircraft under a sampled rate law.

    p_dot = gain command(t - delay) - inv_T_roll p; returned = proportional p + integral (integral
    of p).

    Attributes
    ----------
    gain : rad/s2 of a full command.
    inv_T_roll : inverse of the roll time constant, 1/s.
    delay : delay of servo and computer, s.
    proportional, integral : gains of the law, command per rad/s and per rad.
    rate : frames a second.
    """

    gain: float
    inv_T_roll: float
    delay: float
    proportional: float
    integral: float
    rate: float


@dataclass(frozen=True)
class SweepScenario:
    """A named sweep.

    Attributes
    ----------
    loop : the roll axis of a small aircraft; None if ``airframe`` of the X-29-like aircraft
        flies.
    amplitude : amplitude of the excitation, in the unit of the command.
    low, high : lowest and highest frequency of the excitation, Hz.
    duration : s, of each flight.
    flights : number of flights that are pooled.
    gyro : standard deviation of the noise of the gyro, rad/s.
    rough_air : standard deviation of the rolling acceleration by rough air, rad/s2.
    form : form of the fitted transfer function; empty for none.
    band : lowest and highest frequency of the estimate, Hz.
    """

    name: str
    title: str
    about: str
    distance: str
    loop: RollLoop | None
    airframe: str
    amplitude: float
    low: float
    high: float
    duration: float
    flights: int
    gyro: float
    rough_air: float
    form: str
    band: tuple[float, float]
    seed: int


class _Roll(Strict):
    gain: Quantity
    inv_T_roll: Quantity
    delay: Quantity
    proportional: float = Field(gt=0)
    integral: float = Field(ge=0)
    rate: Quantity


class _Excitation(Strict):
    amplitude: float = Field(gt=0)
    low: Quantity
    high: Quantity
    duration: Quantity
    flights: int = Field(default=1, ge=1, le=20)


class _Noise(Strict):
    gyro: Quantity = 0.0
    rough_air: Quantity = 0.0


class _Sweep(Strict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["sweep"]
    title: Annotated[str, Field(min_length=1)]
    about: str = ""
    distance: Literal["same equations, finer step", "no model"]
    seed: int = Field(default=1, ge=0)
    airframe: Literal["P", "S", "F", "D", "R"] | None = None
    loop: _Roll | None = None
    sweep: _Excitation
    noise: _Noise = _Noise()
    form: str = ""
    band: Annotated[list[Quantity], Field(min_length=2, max_length=2)]


def sweep_scenario_of(document: Mapping[str, Any], name: str, where: str) -> SweepScenario:
    """Return a SweepScenario from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong: one line with file
        and key.
    """
    content = checked(_Sweep, document, where)
    if (content.airframe is None) == (content.loop is None):
        remedy = "give the table [loop], or airframe of the X-29-like aircraft"
        raise DeclarationError("one of loop and airframe is due", where=where, remedy=remedy)
    if content.airframe is not None and content.form:
        what = "the airframe is behind its sensors and the law, which no form describes"
        raise DeclarationError(what, where=f"{where}, key form", remedy="leave form out")

    def number(value: Quantity, unit: str, key: str) -> float:
        return positive_si(value, unit, f"{where}, key {key}", {"hz": "1/s"})

    def noise_std(value: Quantity, unit: str, key: str) -> float:
        std = si(value, unit, f"{where}, key {key}")
        return std if std == 0.0 else positive(std, f"{where}, key {key}")

    loop = None
    if content.loop is not None:
        r = content.loop
        loop = RollLoop(
            number(r.gain, "rad/s2", "loop.gain"),
            number(r.inv_T_roll, "1/s", "loop.inv_T_roll"),
            number(r.delay, "s", "loop.delay"),
            r.proportional,
            r.integral,
            number(r.rate, "1/s", "loop.rate"),
        )
    low = number(content.sweep.low, "1/s", "sweep.low")
    high = number(content.sweep.high, "1/s", "sweep.high")
    duration = number(content.sweep.duration, "s", "sweep.duration")
    rate = loop.rate if loop is not None else 80.0
    if not low < high < 0.4 * rate:
        what = f"a sweep from {low:g} to {high:g} Hz at {rate:g} Hz"
        raise DeclarationError(
            what,
            where=f"{where}, key sweep",
            remedy=f"give low below high, and that below {0.4 * rate:g} Hz",
        )
    if duration * rate * content.sweep.flights > MOST_SAMPLES or duration < 5.0 / low:
        what = f"{content.sweep.flights} flights of {duration:g} s"
        remedy = (
            f"give {5.0 / low:g} s or more, five periods of the lowest, and {MOST_SAMPLES} samples "
            "in all at most"
        )
        raise DeclarationError(what, where=f"{where}, key sweep.duration", remedy=remedy)
    band_low, band_high = (number(end, "1/s", "band") for end in content.band)
    return SweepScenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        loop,
        content.airframe or "",
        content.sweep.amplitude,
        low,
        high,
        duration,
        content.sweep.flights,
        noise_std(content.noise.gyro, "rad/s", "noise.gyro"),
        noise_std(content.noise.rough_air, "rad/s2", "noise.rough_air"),
        content.form,
        (band_low, band_high),
        content.seed,
    )


TAPER_SHARE = 0.02  # tapered share at both ends of the sweep
AIR_TIME = 0.5  # s, time constant of rough air
UNSTABLE_ROLL_RATE = 1e6  # rad/s; a larger roll rate means instability
FINE_FREQUENCIES = 20_000  # frequencies of the true distance from -1
SPLINE_FREQUENCIES = 1_000  # frequencies between which splines give the true margins, to 1e-7


def fly_sweep(scenario: SweepScenario, rng: np.random.Generator, number: int = 1) -> Record:
    """Simulate one flight of a loop.

    Inputs are ``sweep`` and ``command`` (sweep - returned), outputs ``returned`` and the angular
    rate that is fed back, ``p`` or ``q``.

    Raises DeclarationError if the loop is unstable.
    """
    rate = frame_rate(scenario)
    time = np.arange(int(scenario.duration * rate + 1e-9)) / rate
    edges = 2.0 * math.pi * scenario.low, 2.0 * math.pi * scenario.high
    shape = Sweep(
        scenario.amplitude,
        *edges,
        scenario.duration,
        0.0,
        TAPER_SHARE * scenario.duration,
        Spacing.LOGARITHMIC,
    )
    sweep = np.asarray(shape(time))
    if scenario.loop is not None:
        command, returned, turn_rate = _roll(scenario.loop, sweep, scenario, rng)
        name, unit = "p", "1"
    else:
        noise = LoopNoise(gyro=math.degrees(scenario.gyro))
        x29 = load_x29(scenario.airframe)
        _, command, returned, turn_rate, _ = loop_test(x29, sweep, rng, noise)
        name, unit = "q", "deg"
    inputs = (Channel.of("sweep", unit, sweep), Channel.of("command", unit, command))
    outputs = (Channel.of("returned", unit, returned), Channel.of(name, "rad/s", turn_rate))
    return Record(time, inputs, outputs, Hold.PREVIOUS, f"flight {number}")


def frame_rate(scenario: SweepScenario) -> float:
    """Return the number of frames a second, which is the rate of the record."""
    if scenario.loop is not None:
        return scenario.loop.rate
    return 1.0 / load_x29(scenario.airframe).frame


def _roll(
    loop: RollLoop, sweep: np.ndarray, scenario: SweepScenario, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return command, returned signal and measured roll rate of each frame; the command is held."""
    whole, decay, now, before = _frame_delay(loop)
    step = 1.0 / loop.rate
    share = math.exp(-step / AIR_TIME)
    white, gyro = rng.standard_normal(sweep.size), scenario.gyro * rng.standard_normal(sweep.size)
    command, returned, measured = (np.zeros(sweep.size) for _ in range(3))
    delayed = np.zeros(sweep.size + whole + 2)  # commands, zero before the first frame
    p = angle = air = 0.0
    for n in range(sweep.size):
        measured[n] = p + gyro[n]
        angle += step * measured[n]
        returned[n] = loop.proportional * measured[n] + loop.integral * angle
        command[n] = sweep[n] - returned[n]
        delayed[n + whole + 1] = command[n]
        air = share * air + math.sqrt(1.0 - share**2) * scenario.rough_air * white[n]
        p = decay * p + now * delayed[n + 1] + before * delayed[n] + step * air
        if not abs(p) < UNSTABLE_ROLL_RATE:
            raise DeclarationError(
                "the loop is unstable",
                where="key loop",
                remedy="lower the gains of the law, or the delay",
            )
    return command, returned, measured


def _frame_delay(loop: RollLoop) -> tuple[int, float, float, float]:
    """Return the parts of the roll dynamics over a frame.

    They are the whole frames of the delay, the decay of p, and the gains of the commands at the end
    of the frame and one frame before.
    """
    step, a = 1.0 / loop.rate, loop.inv_T_roll
    whole = int(loop.delay / step + 1e-9)
    rest = max(loop.delay - whole * step, 0.0)
    reach = loop.gain / a
    now = reach * (1.0 - math.exp(-a * (step - rest)))
    before = reach * math.exp(-a * (step - rest)) * (1.0 - math.exp(-a * rest))
    return whole, math.exp(-a * step), now, before


def true_loop(scenario: SweepScenario, omega: np.ndarray) -> np.ndarray:
    """Return the sampled broken-loop response, command to returned signal, at ``omega`` rad/s."""
    if scenario.loop is None:
        x29 = load_x29(scenario.airframe)
        return np.asarray(open_loop(x29)(np.exp(1j * omega * x29.frame))).ravel()
    loop = scenario.loop
    whole, decay, now, before = _frame_delay(loop)
    later = np.exp(-1j * omega / loop.rate)
    plant = later ** (whole + 1) * (now + before * later) / (1.0 - decay * later)
    return np.asarray(plant * (loop.proportional + loop.integral / loop.rate / (1.0 - later)))


def true_margins(scenario: SweepScenario) -> Mapping[str, float]:
    """Return the margins of the true loop by python-control: dB, deg, s; and distance from -1."""
    import control

    last = 0.999 * math.pi * frame_rate(scenario)
    response = true_loop(scenario, np.geomspace(0.05, last, FINE_FREQUENCIES))
    omega = np.geomspace(0.05, last, SPLINE_FREQUENCIES)
    data = control.frd(true_loop(scenario, omega), omega, smooth=True)
    gains, phases, _, _, crossovers, _ = control.stability_margins(data, returnall=True)
    decibel = 20.0 * np.log10(np.asarray(gains))
    out = {"distance": float(np.min(np.abs(1.0 + response)))}
    if np.any(decibel > 0.0):
        out["gain_increase"] = float(np.min(decibel[decibel > 0.0]))
    if np.any(decibel <= 0.0):
        out["gain_decrease"] = float(np.max(decibel[decibel <= 0.0]))
    if len(phases):
        phase, at = np.asarray(phases), np.asarray(crossovers)
        out["phase_margin"] = float(phase[np.argmin(np.abs(phase))])
        out["delay_margin"] = float(np.min(np.radians(phase) % (2.0 * math.pi) / at))
    return out


def true_parameters(scenario: SweepScenario) -> Mapping[str, float]:
    """Return the true parameters of the form ``roll``; empty for another form or aircraft."""
    loop = scenario.loop
    if loop is None or scenario.form != "roll":
        return {}
    return {"gain": loop.gain, "inv_T_roll": loop.inv_T_roll, "delay": loop.delay}


MAIN = "comparison.json"


@dataclass(frozen=True, eq=False)
class SweepStudy:
    """Results of a sweep.

    Attributes
    ----------
    records : records of the flights.
    response : response of the rate to the command, with the fitted form; None without a form.
    loop : response of the returned signal to the command, with its margins.
    rows : estimated and true values.
    estimate : the estimated values with their covariance.
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
    """Simulate the flights, and estimate from their files as ``flightid response`` does.

    Raises
    ------
    FlightidError : the loop is unstable, or the flights do not resolve the band.
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
    """Return parameters of the fitted form and margins, with true values and as an estimate."""
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
        rows.append(
            Row(name, UNITS[margin.kind], margin.size.value, margin.size.std, true.get(name))
        )
    first = len(covariance)
    joint = np.diag([row.std**2 for row in rows])
    joint[:first, :first] = covariance
    estimate = Estimate(
        "frequency-response",
        tuple(row.name for row in rows),
        tuple(row.unit for row in rows),
        np.array([row.estimate for row in rows], dtype=float),
        joint,
        Outcome.CONVERGED,
        0.0,
        (),
        np.zeros(0),
        (),
    )
    return tuple(rows), estimate


def print_sweep(study: SweepStudy, out: Console | None = None, details: str = BELOW) -> None:
    """Print a study: estimates and truth, the model, the margins."""
    out = out or console()
    print_summary(out, sweep_summary(study, details))
    show_table(out, estimates_table("Against the truth", study.rows))
    for line in model_lines(study):
        print_paragraph(out, line, indent=0)
    if (loop := study.loop.loop) is not None:
        show_blocks(out, loop_tables(loop))
        for line in margin_lines(loop):
            print_paragraph(out, line, indent=0)
    for line in cautions(study):
        print_paragraph(out, f"warning: {line}", indent=0)


def sweep_summary(study: SweepStudy, details: str) -> Summary:
    """Return the summary of the flights and the results."""
    s = study.scenario
    flown = (
        f"{s.flights} flight{'s' * (s.flights > 1)} of {s.duration:g} s, a sweep of the command "
        f"from {s.low:g} to {s.high:g} Hz"
    )
    inside = sum(abs(row.sigmas) <= 2.0 for row in study.rows if row.sigmas is not None)
    determined = sum(row.sigmas is not None for row in study.rows)
    shown = [row for row in study.rows if row.name in ("gain_increase", "phase_margin")]
    margins = "; ".join(
        f"{row.name.replace('_', ' ')} {number_text(row.estimate, row.std)} {row.unit}"
        for row in shown
    )
    return Summary(
        f"{s.name}: {flown}",
        f"{inside} of {determined} true values within two sigmas",
        margins,
        details=details,
    )


def model_lines(study: SweepStudy) -> list[str]:
    """Return the fitted transfer function and its assessment."""
    return [] if study.response is None else fit_lines(study.response, 0, 0)


def cautions(study: SweepStudy) -> tuple[str, ...]:
    """Return the cautions on the estimates."""
    both = (*(study.response.cautions if study.response is not None else ()), *study.loop.cautions)
    return tuple(dict.fromkeys(both))


def write_sweep(study: SweepStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, responses, figures, page, ``truth.json`` and ``comparison.json`` (last)."""
    with study_folder(folder, MAIN) as scratch:
        for n, record in enumerate(study.records, 1):
            write_record(scratch, record, "record" if n == 1 else f"record_{n}", simulated=True)
        estimates = [found for found in (study.response, study.loop) if found is not None]
        tables = [responses_csv(found).partition("\n") for found in estimates]
        text = tables[0][0] + "\n" + "".join(rows for _, _, rows in tables)  # one header
        write_text(scratch / "responses.csv", text)
        drawn = draw_into(scratch, sweep_figures(study), figures)
        write_page(scratch, sweep_page(study, drawn))
        write_json(scratch / "truth.json", truth_content(study))
        write_json(scratch / MAIN, sweep_comparison(study))
    return Path(folder)


def sweep_figures(study: SweepStudy) -> Iterator[Named]:
    """Yield the figures of the responses: file stem and drawing function."""
    from scenarios.plots import flying_qualities as drawing

    yield "response", partial(drawing.figure_response, study.response or study.loop)
    if study.response is not None:
        yield "mismatch", partial(drawing.figure_mismatch, study.response)
    yield "loop", partial(drawing.figure_margins, study.loop)


def truth_content(study: SweepStudy) -> dict[str, Any]:
    """Return the true parameters and margins."""
    true = {
        row.name: {"value": row.true, "unit": row.unit}
        for row in study.rows
        if row.true is not None
    }
    return {"schema": "flightid/truth/1", "parameters": true, "distance": study.scenario.distance}


def sweep_comparison(study: SweepStudy) -> dict[str, Any]:
    """Return the content of ``comparison.json``."""
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


def sweep_page(study: SweepStudy, figure_files: tuple[Drawn, ...]) -> Page:
    """Return the page of a study."""
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
            *section("Figures", *figure_blocks(figure_files)),
            *section("Against the truth", estimates_table("Parameters and margins", study.rows)),
            *section("Transfer function", *model),
            *section("Stability margins", *margins),
            *section(
                "What was flown",
                Prose(scenario.about),
                Prose(f"Flight and model: {distance_text(scenario.distance)}.", "note"),
            ),
        ),
        reproduction=reproduction(
            ("flightid", "run", scenario.name, "--seed", str(study.seed)), f"Seed {study.seed}.", []
        ),
        created=now(),
    )
