"""Coverage of frequency responses, margins and fits: ``python -m exam coverage-responses ROWS``.

Each case is a flight whose response is known, flown with many seeds and analysed as a user would.
Every run is one line of the file ROWS, so that a campaign that was stopped goes on where it ended.
``--page`` writes the table into a page between two marks.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import flightid as fid
from exam.coverage.estimators import read_rows
from exam.coverage.streams import beside_the_bank, stick_multisine, watched
from exam.options import Parser
from ident.flying_qualities.attitude_criteria import GAIN_MARGIN, attitude_bandwidth
from ident.flying_qualities.stability_margins import NORMAL_HALF_WIDTH, stability_margins
from ident.frequency_response import EvenSignals, Spectra, estimate_responses
from ident.frequency_response.estimate import frequencies as response_frequencies
from ident.frequency_response.estimate import window_lengths
from ident.statistics.intervals import clustered_share
from scenarios.files.vehicles import VehicleFile
from scenarios.responses.fitting import target_of
from scenarios.studies.catalogue import load_document
from scenarios.trials.sweeps import (
    SweepScenario,
    fly_sweep,
    frame_rate,
    sweep_scenario_of,
    true_loop,
)
from scenarios.trials.sweeps import true_margins as known_margins
from scenarios.watching.loop_margins import LoopNames, MarginSession, finish_second, shown, take
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import loop_test, margins, open_loop

BEGIN, END = "<!-- response coverage: begin -->", "<!-- response coverage: end -->"
LOW, HIGH = 0.93, 0.97  # where the share of 95 % intervals should lie
Counts = dict[str, list[int]]  # by quantity: how many intervals hold the truth, of how many

# ---- Bands of responses: one input, two that move together, feedback

STEP, DURATION, NOISE = 0.02, 300.0, 1.0 / 3.0
GRID = np.geomspace(0.05, 5.0, 60)
SHORT_PERIOD, LAG = ((6.0, 7.2), (1.0, 3.2, 16.0)), ((3.0,), (1.0, 2.0))
LAW = 0.5  # of the feedback


@cache
def _held(system: tuple[tuple[float, ...], tuple[float, ...]]) -> tuple[np.ndarray, np.ndarray]:
    from scipy.signal import cont2discrete

    top, bottom, _ = cont2discrete(system, STEP, "zoh")
    return np.ravel(top), np.asarray(bottom)


def _true(system: tuple[tuple[float, ...], tuple[float, ...]]) -> np.ndarray:
    top, bottom = _held(system)
    z = np.exp(2j * math.pi * GRID * STEP)
    return np.asarray(np.polyval(top, z) / np.polyval(bottom, z))


def known_flight(case: str, seed: int, noise: float = 1.0) -> tuple[EvenSignals, np.ndarray]:
    """A record of 300 s and its true responses ``(q, F)``: ``one`` input, ``two`` with a
    correlation of 0.7, ``feedback`` of the output with and ``direct`` without its excitation.
    ``noise`` : times a third of the output."""
    from scipy.signal import butter, lfilter

    rng = np.random.default_rng([40, seed])
    count = round(DURATION / STEP)
    one, other = (lfilter(*butter(2, 0.12), rng.standard_normal(count)) for _ in range(2))
    error = lfilter(*butter(1, 0.04), rng.standard_normal(count))
    top, bottom = _held(SHORT_PERIOD)
    clean = lfilter(top, bottom, one)
    if case in ("one", "two"):
        inputs = [one]
        if case == "two":
            inputs.append((one + other) / math.sqrt(2.0))
            clean = clean + lfilter(*_held(LAG), inputs[1])
        y = clean + error * noise * NOISE * clean.std() / error.std()
        exact = [_true(each) for each in (SHORT_PERIOD, LAG)[: len(inputs)]]
        return EvenSignals(STEP, np.array(inputs), y[None]), np.array(exact)
    error = error * noise * NOISE * clean.std() / error.std()
    closed = np.polyadd(bottom, LAW * top)
    y = lfilter(top, closed, one) + lfilter(bottom, closed, error)
    record = EvenSignals(STEP, (one - LAW * y)[None], y[None], one[None])
    if case == "direct":
        record = EvenSignals(STEP, record.inputs, record.outputs)
    return record, _true(SHORT_PERIOD)[None]


def bands(case: str, seed: int) -> Counts:
    """Points whose 95 % band holds the true response."""
    record, exact = known_flight(case, seed)
    found = estimate_responses([record], GRID, Spectra(window_lengths([DURATION])))
    response = found.response[0]
    inside = {
        "magnitude": np.abs(np.abs(response) - np.abs(exact)) <= found.half_width()[0],
        "phase": np.abs(np.angle(response / exact)) <= found.phase_half_width()[0],
        "circle": np.abs(response - exact) <= found.radius()[0],
    }
    return {name: [int(each.sum()), each.size] for name, each in inside.items()}


# ---- Margins of the X-29-like loop, of a record and of a stream


@cache
def true_margins(airframe: str) -> Mapping[str, float]:
    """Margins of the known loop by their names; the distance from its response."""
    x29 = load_x29(airframe)
    exact = margins(x29)
    omega = np.linspace(1.0, 75.0, 20001)
    away = float(np.min(np.abs(1.0 + np.ravel(open_loop(x29)(np.exp(1j * omega * x29.frame))))))
    return {
        "gain_increase": exact.gain_increase,
        "gain_decrease": exact.gain_decrease,
        "phase_margin": exact.phase,
        "delay_margin": math.radians(exact.phase) / exact.crossover,
        "distance": away,
    }


def _swept(airframe: str, seed: int, low: float, high: float, duration: float) -> np.ndarray:
    """Time, command, excitation and returned signal, ``(4, N)``."""
    from scipy.signal import chirp

    x29 = load_x29(airframe)
    time = x29.frame * np.arange(int(duration / x29.frame))
    sweep = 0.5 * chirp(time, low, duration, high, method="logarithmic")
    rows = loop_test(x29, sweep, np.random.default_rng([41, seed]))
    return np.stack([time, rows[1], rows[0], rows[2]])


def record_margins(airframe: str, seed: int) -> Counts:
    """Margins of a sweep of 120 s from 0.1 to 12 Hz whose interval holds the known one."""
    rows = _swept(airframe, seed, 0.1, 12.0, 120.0)
    names = ("time [s]", "command", "sweep", "returned")
    frame = pd.DataFrame(dict(zip(names, rows, strict=True)))
    found = fid.frequency_response(
        frame, "command", "returned", reference="sweep", band=(0.2, 12.0), margins="minus"
    )
    exact = true_margins(airframe)
    out: Counts = {}
    for name, each in found.margins.items():
        if name in exact and each["std"] > 0.0:
            out[name] = [int(each["low"] <= exact[name] <= each["high"]), 1]
    return out


def stream_margins(airframe: str, seed: int) -> Counts:
    """Margins after every second of a sweep of 60 s from 0.2 to 10 Hz, and those at its end."""
    session = MarginSession(LoopNames("minus", "command", "returned", "sweep"), "loop", (0.3, 10.0))
    take(session, _swept(airframe, seed, 0.2, 10.0, 60.0))
    finish_second(session)
    exact = true_margins(airframe)
    out: Counts = {}
    for number, point in enumerate(session.points, start=1):
        for name, margin in shown(point):
            inside = int(margin.low <= exact[name] <= margin.high)
            first = ["when first shown"] if name not in out else []
            last = ["at the end"] if number == len(session.points) else []
            for key in (name, *first, *last):
                held, count = out.get(key, [0, 0])
                out[key] = [held + inside, count + 1]
    return out


# ---- The low-order equivalent system from responses and in time

LOES = {
    **{"L_alpha": -1.5, "M_alpha": -6.5, "L_delta": -0.06, "M_delta": 0.30},
    **{"L_q": 0.97, "M_q": -2.25, "inv_tau": 10.4, "delay": 0.08},
}
AIRSPEED, GRAVITY, START_ERROR = 208.0, 9.8, 1.15
LOES_RATE, FINE, SENSORS = 50.0, 20, {"alpha": 0.001, "q": 0.002, "nz": 0.02}


def loes_flight(
    seed: int,
    duration: float = 60.0,
    moved: Callable[[np.ndarray], np.ndarray] | None = None,
) -> pd.DataFrame:
    """A sweep of the stick from 0.05 to 3 Hz that begins at rest, or the stick that ``moved`` gives
    at the samples; the equations by their exact transition over steps of 1 ms, the delay a whole
    number of them."""
    from scipy.linalg import expm
    from scipy.signal import chirp

    d, h = LOES, 1.0 / (LOES_RATE * FINE)
    A = np.zeros((4, 4))
    A[0, :3] = d["L_alpha"], d["L_q"], d["L_delta"]
    A[1, :3] = d["M_alpha"], d["M_q"], d["M_delta"]
    A[2, 2:] = -d["inv_tau"], d["inv_tau"]
    step = expm(A * h)
    time = np.arange(round(duration * LOES_RATE)) / LOES_RATE
    sweep = partial(chirp, f0=0.05, t1=duration, f1=3.0, method="logarithmic", phi=-90.0)
    stick = (moved or sweep)(time)
    late = np.concatenate([np.zeros(round(d["delay"] / h)), np.repeat(stick, FINE)])
    states = np.zeros((time.size, 3))
    x = np.zeros(4)
    for k in range(time.size * FINE):
        if k % FINE == 0:
            states[k // FINE] = x[:3]
        x[3] = late[k]
        x[:3] = (step @ x)[:3]
    alpha, q, _ = states.T
    nz = AIRSPEED / GRAVITY * (q - states @ A[0, :3])
    rng = np.random.default_rng([42, seed])
    columns = {"time [s]": time, "stick": stick}
    for (name, unit), clean in zip(
        (("alpha", "rad"), ("q", "rad/s"), ("nz", "g")), (alpha, q, nz), strict=True
    ):
        columns[f"{name} [{unit}]"] = clean + SENSORS[name] * rng.standard_normal(time.size)
    return pd.DataFrame(columns)


def loes_both(case: str, seed: int) -> Counts:
    """Parameters fitted to the responses and in time: how many are within two standard deviations
    of the truth, and within two of each other."""
    frame = loes_flight(seed)
    with tempfile.TemporaryDirectory() as folder:
        vehicle = Path(folder) / "vehicle.toml"
        lines = [f"airspeed = {AIRSPEED}", f"gravity = {GRAVITY}", "[derivatives]"]
        lines += [f"{name} = {START_ERROR * value}" for name, value in LOES.items()]
        text = "\n".join(['name = "x"', *lines]) + "\n"
        vehicle.write_text(text, encoding="utf-8", newline="\n")
        options: dict[str, Any] = {"vehicle": vehicle, "hold": "previous"}
        swept = fid.frequency_response(
            frame, "stick", ["alpha", "q", "nz"], model="loes", **options
        )
        timed = fid.identify(frame, "loes", **options)
    fitted = swept.details.model
    assert fitted is not None
    fit = fitted.fit
    estimate = timed.details.found.estimate
    out: Counts = {name: [0, 0] for name in ("from responses", "in time", "one another")}
    for name, value, std in zip(fit.names, fit.values.tolist(), fit.std.tolist(), strict=True):
        if name not in estimate.names:
            continue
        other, sigma = estimate.value(name), estimate.sigma(name)
        errors = {
            "from responses": (value - LOES[name]) / std,
            "in time": (other - LOES[name]) / sigma,
            "one another": (value - other) / math.hypot(std, sigma),
        }
        for key, error in errors.items():
            out[key] = [out[key][0] + int(abs(error) <= 2.0), out[key][1] + 1]
    return out


def loes_stream(case: str, seed: int) -> Counts:
    """Thirty seconds of a multisine of the stick, on line and by the bank."""
    rng = np.random.default_rng([45, seed])
    share = rng.uniform(0.8, 1.2, len(LOES))
    start = {name: float(LOES[name] * by) for name, by in zip(LOES, share, strict=True)}
    constants = {"airspeed": AIRSPEED, "gravity": GRAVITY}
    frame = loes_flight(1000 + seed, 32.0, stick_multisine)
    return beside_the_bank(VehicleFile("x", "loes", constants, start), frame, LOES)


# ---- The roll loop of a small aircraft: margins, their crossings, the fitted form


@cache
def roll_loop() -> tuple[SweepScenario, Mapping[str, float]]:
    """The scenario ``uav-sweep`` and its known margins and crossings, rad/s."""
    from scipy.optimize import brentq

    scenario = sweep_scenario_of(*load_document("uav-sweep", ()))

    def loop(omega: float) -> complex:
        return complex(true_loop(scenario, np.array([omega]))[0])

    crossings = {
        "gain crossing": brentq(lambda omega: abs(loop(omega)) - 1.0, 5.0, 40.0),
        "phase crossing": brentq(
            lambda omega: math.atan2(-loop(omega).imag, -loop(omega).real), 25.0, 80.0
        ),
    }
    return scenario, {**known_margins(scenario), **crossings}


def swept_roll_loop(case: str, seed: int) -> Counts:
    """Intervals of margins and of their crossings from three sweeps that hold the known ones."""
    scenario, exact = roll_loop()
    rng = np.random.default_rng([46, seed])
    records = []
    for number in range(1, scenario.flights + 1):
        flight = fly_sweep(scenario, rng, number)
        command, returned, sweep = (
            flight[name].values[None] for name in ("command", "returned", "sweep")
        )
        records.append(EvenSignals(1.0 / frame_rate(scenario), command, returned, sweep))
    low, high = scenario.band
    lengths = window_lengths([scenario.duration], low)
    found = estimate_responses(records, response_frequencies(low, high), Spectra(lengths))
    margins = stability_margins(target_of(found, (0, 0), "loop"))
    ends = {name: (each.low, each.high) for name, each in margins.named.items()}
    crossings = {"gain crossing": margins.phase, "phase crossing": margins.gain_increase}
    for name, margin in crossings.items():
        if margin is not None:
            at = margin.frequency
            ends[name] = (
                at.value - NORMAL_HALF_WIDTH * at.std,
                at.value + NORMAL_HALF_WIDTH * at.std,
            )
    return {name: [int(low <= exact[name] <= high), 1] for name, (low, high) in ends.items()}


# ---- Bandwidth and phase delay of a short period with a delay

LATE = 5  # samples of the delay


@cache
def true_bandwidth() -> Mapping[str, float]:
    """Bandwidth of the known attitude, from its response at a thousand frequencies."""
    omega = np.geomspace(0.5, 20.0, 20001)
    top, bottom = _held(SHORT_PERIOD)
    z = np.exp(1j * omega * STEP)
    rate = np.polyval(top, z) / np.polyval(bottom, z) * z**-LATE
    phase = np.degrees(np.unwrap(np.angle(rate))) - 90.0
    gain = 20.0 * np.log10(np.abs(rate) / omega)
    neutral, bandwidth = (float(np.interp(-level, -phase, omega)) for level in (-180.0, -135.0))
    level = float(np.interp(neutral, omega, gain)) + GAIN_MARGIN
    before = omega <= neutral
    line = np.linspace(neutral, 2.0 * neutral, 201)
    slope = float(np.polyfit(line, np.interp(line, omega, phase), 1)[0])
    return {
        "frequency of -180 deg": neutral,
        "phase bandwidth": bandwidth,
        "gain bandwidth": float(np.interp(-level, -gain[before], omega[before])),
        "phase delay": -0.5 * math.radians(slope),
    }


def bandwidths(noise: str, seed: int) -> Counts:
    """Intervals of bandwidths and phase delay that hold the known ones; ``noise`` : its share of
    the output, over a third."""
    record, _ = known_flight("one", seed, float(noise))
    output = np.concatenate([np.zeros((1, LATE)), record.outputs[:, :-LATE]], axis=1)
    late = EvenSignals(STEP, record.inputs, output)
    found = estimate_responses([late], GRID, Spectra(window_lengths([DURATION])))
    known = attitude_bandwidth(target_of(found, (0, 0), "q"), rate=True)
    quantities = (known.neutral, known.phase, known.gain, known.delay)
    out: Counts = {}
    for (name, exact), each in zip(true_bandwidth().items(), quantities, strict=True):
        if each is not None:
            out[name] = [int(abs(each.value - exact) <= NORMAL_HALF_WIDTH * each.std), 1]
    return out


# ---- The campaign

Case = tuple[str, Callable[[str, int], Counts], int, str]  # argument, work, runs, description
CASES: Mapping[str, Case] = {
    "one": ("one", bands, 200, "response, one input"),
    "two": ("two", bands, 200, "responses, two inputs, correlation 0.7"),
    "feedback": ("feedback", bands, 200, "response, feedback, joint input-output"),
    "direct": ("direct", bands, 100, "response, feedback, direct"),
    "margins-F": ("F", record_margins, 400, "margins, X-29-like loop F"),
    "margins-S": ("S", record_margins, 400, "margins, X-29-like loop S"),
    "stream-F": ("F", stream_margins, 100, "margins of a stream, loop F"),
    "stream-S": ("S", stream_margins, 100, "margins of a stream, loop S"),
    "roll-loop": ("", swept_roll_loop, 200, "uav-sweep, three sweeps"),
    "bandwidth": ("1", bandwidths, 200, "bandwidth, noise of a third"),
    "bandwidth-quiet": ("0.3333", bandwidths, 200, "bandwidth, noise of a ninth"),
    "loes": ("", loes_both, 100, "low-order equivalent system, within two sigmas"),
    "online-rigid": ("rigid", watched, 100, "on line, rigid"),
    "online-lateral": ("lateral", watched, 100, "on line, lateral"),
    "online-longitudinal": ("longitudinal", watched, 100, "on line, longitudinal"),
    "online-own": ("own", watched, 100, "on line, a user's model"),
    "online-f16": ("f16", watched, 100, "on line, F-16 of Morelli's program"),
    "online-f16-unstable": ("f16-unstable", watched, 100, "on line, the same, unstable"),
    "online-loes": ("", loes_stream, 100, "on line, low-order equivalent system"),
}


def measure(rows: Path, cases: Sequence[str], runs: int | None) -> None:
    """Append every run that the file does not hold yet, ``runs`` at most of each case, all cases
    advancing together."""
    kept = {(each["case"], each["run"]) for each in read_rows(rows)}
    most = {case: min(CASES[case][2], CASES[case][2] if runs is None else runs) for case in cases}
    for run in range(max(most.values(), default=0)):
        for case in cases:
            if run >= most[case] or (case, run) in kept:
                continue
            argument, work, _, _ = CASES[case]
            row = {"case": case, "run": run, "held": work(argument, run)}
            with rows.open("a", encoding="utf-8", newline="\n") as out:
                out.write(json.dumps(row) + "\n")


def statistics(rows: Iterable[Mapping[str, Any]]) -> dict[str, tuple[int, float, float, float]]:
    """By quantity the number of runs that have it, the share of intervals that hold the truth, and
    that share's own 95 % interval over runs drawn again: points of one run are not independent."""
    every = [each["held"] for each in rows]
    out = {}
    for name in dict.fromkeys(name for held in every for name in held):
        counts = np.array([held[name] for held in every if name in held])
        low, high = clustered_share(counts[:, 0], counts[:, 1], np.random.default_rng(0))
        share = float(counts[:, 0].sum() / counts[:, 1].sum())
        out[name] = len(counts), share, low, high
    return out


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The measured cases as a table of Markdown."""
    lines = ["| flights | runs | quantity | hold the truth | 95 % interval |\n"]
    lines.append("|---|---|---|---|---|\n")
    for case, (_, _, _, words) in CASES.items():
        found = statistics(each for each in rows if each["case"] == case)
        for name, (runs, share, low, high) in found.items():
            said = name.replace("_", " ")
            spread = f"{100 * low:.1f} to {100 * high:.1f} %"
            lines.append(f"| {words} | {runs} | {said} | {100 * share:.1f} % | {spread} |\n")
    return "".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked and print or write the table; 2 with one line where that fails."""
    name = "coverage-responses"
    parser = Parser(name, "coverage of frequency responses, margins and fits")
    text = "file of runs, one a line; what it holds is not run again"
    parser.add_argument("rows", type=Path, help=text)
    parser.add_argument("--runs", type=int, metavar="N", help="of each case, at most; 0: the table")
    parser.add_argument("--only", action="append", choices=list(CASES), help="this case")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="write the table between marks"
    )
    asked = parser.parse_args(arguments)
    try:
        if asked.runs is not None and asked.runs < 0:
            raise ValueError(f"--runs {asked.runs}: give 0 or more")
        measure(asked.rows, asked.only or list(CASES), asked.runs)
        found = table(read_rows(asked.rows))
        if asked.page is None:
            print(found, end="")
            return 0
        text = asked.page.read_text(encoding="utf-8")
        if BEGIN not in text or END not in text:
            raise ValueError(f"{asked.page} has no marks {BEGIN} and {END}")
        before, after = text.split(BEGIN, 1)[0], text.split(END, 1)[1]
        whole = f"{before}{BEGIN}\n\n{found}\n{END}{after}"
        asked.page.write_text(whole, encoding="utf-8", newline="\n")
    except (OSError, ValueError, KeyError) as error:
        print(f"python -m exam {name}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0
