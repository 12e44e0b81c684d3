"""Declaration of a closed-loop scenario, published low-order equivalents, simulated flight, and the
flight compared with the response of the linear loop.

Published estimates are only compared with ours, never used for them. A scenario may use the
published start, P0 and R. The nonlinear loop has a break-out, a progressive gearing, and surface
limits; the linear loop has a constant gain instead.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from scenarios.studies.declaration import Choice
from scenarios.studies.schema import standard_deviations
from sim.closed_loop.airframe import X29, load_x29
from sim.closed_loop.linear import EquivalentSystem, equivalent_system, respond
from sim.closed_loop.nonlinear import (
    ClosedLoopTruth,
    FlightOutcome,
    SmoothStick,
    doublet,
    fly_closed_loop,
    manual_stick,
    three_two_one_one,
)
from sim.declaration.model import Model, Noise
from sim.errors import DeclarationError
from sim.maneuvers import MultiStep
from sim.record import Channel, Record
from sim.truth.flight import fly
from sim.vehicles.factory import model_from_constants

# ---- What a scenario of the closed loop declares

_NONE: Mapping[str, float] = MappingProxyType({})
OUTPUTS = ("alpha", "q", "nz")  # rad, rad/s, g
# Further methods of a scenario -> their names in tables.
METHODS: Mapping[str, str] = MappingProxyType(
    {
        "paper": "plain bank, published P0",
        "paper-other": "plain filter at the next grid point",
        "paper-density": "plain bank, published Q as a density",
        "plain-quarter": "plain bank, P0 a quarter of the start",
        "held": "plain filter at the refined delay",
        "relinearised": "linearised anew at the bank's delay",
        "refined-printed": "refined, printed P0",
        "refined-quarter": "refined, P0 a quarter of the start",
    }
)


@dataclass(frozen=True)
class StickPlan:
    """The pilot's input: ``kind`` and its numbers (s, in, rad/s).

    ``kind``: 3-2-1-1, doublet, levels or hand-flown. ``times``, ``levels``: for kind levels.
    ``pilot_seed``: for kind hand-flown, independent of the noise.
    """

    kind: str
    amplitude: float = 1.0
    unit: float = 0.5
    start: float = 1.0
    bandwidth: float = 10.0
    pilot_seed: int = 1
    times: tuple[float, ...] = ()
    levels: tuple[float, ...] = ()


@dataclass(frozen=True)
class Spike:
    """A wrong sample of the recorded stick: its time (s) and recorded value (in)."""

    time: float
    size: float


@dataclass(frozen=True)
class LoopFlight:
    """Simulation of the closed loop.

    Attributes
    ----------
    airframe : ``"P"``, ``"S"``, ``"F"``, ``"D"`` or ``"R"``.
    duration : s.
    noise : whether the telemetry is noisy.
    dead_band, curvature : those of the stick, in and 1/in; None: the aircraft's.
    rate_limits : whether the actuators have rate limits.
    low_order : simulate the loop's low-order equivalent, to isolate the effect of the model order.
    gust : spectral density of white forcing of the pitch rate, (rad/s2)^2 s; low order only.
    spike : wrong sample of the recorded stick; the control computer does not see it.
    noise_std : noise of the telemetry by output, rad, rad/s and g; empty: the aircraft's.
    """

    airframe: str
    duration: float
    stick: StickPlan
    noise: bool = True
    dead_band: float | None = None
    curvature: float | None = None
    rate_limits: bool = True
    low_order: bool = False
    gust: float = 0.0
    spike: Spike | None = None
    noise_std: Mapping[str, float] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True)
class LoopEstimation:
    """Estimation from a closed-loop record.

    Attributes
    ----------
    start : starting values by name.
    start_from : scenario whose plain bank gives the starting values instead, or empty.
    noise_from : measurement noise from the ``"sensors"``, or from the record (``"envelope"``).
    noise_share : factor on this noise.
    process_noise : spectral densities by state, (unit/s)^2 s.
    initial_std : initial sigmas of alpha, q and delta; default for alpha and q, as in the paper:
        those of the noise.
    window_start, window_stop : part of the record that is used, s.
    restarts : largest number of restarts of the refined filter from its own result.
    prior : P0 of the parameters: ``"quarter"`` of the start, or ``"printed"`` in Tables 1 and 2.
    engine : implementation of the filters, a key of ``ident.banks.engines.ENGINES``; the results of
        all engines agree to rounding.
    """

    start: Mapping[str, float]
    start_from: str
    noise_from: str
    noise_share: float
    process_noise: Mapping[str, float]
    initial_std: Mapping[str, float] = field(default_factory=lambda: _NONE)
    window_start: float | None = None
    window_stop: float | None = None
    restarts: int = 0
    prior: str = "quarter"
    engine: str = "batched"


@dataclass(frozen=True)
class Against:
    """Another scenario to compare with; ``changes``: as texts of ``--set``."""

    scenario: str
    label: str
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class MarginPlan:
    """Variation of unpublished values in the study of margins.

    ``samples``: points of a Latin hypercube, may be 0. ``seed``: of the points. ``beside``:
    a third airframe to show.
    """

    samples: int
    seed: int = 1
    beside: str = ""


@dataclass(frozen=True)
class Variant:
    """The scenario with another flight or estimation, to show the sensitivity of a result."""

    name: str
    label: str
    flight: LoopFlight
    estimation: LoopEstimation


@dataclass(frozen=True)
class LoopScenario:
    """A named study of the closed loop.

    Attributes
    ----------
    published : columns of the paper's tables to print, the scenario's own first.
    against : what the result is compared with.
    together : scenarios printed side by side as the paper's Table 3.
    methods : further methods, names of ``METHODS``.
    margins : variation of unpublished values, for the loop's margins.
    variants : the same scenario with another flight or estimation.
    stretch : interval (s) whose misfit is reported separately.
    peak : interval (s) with a final peak.
    choices : values that no source gives.
    seeds : number of further flights (seeds 1, 2, ...) for the paper's bank.
    findings : text on conclusions that do not depend on the numbers.
    """

    name: str
    title: str
    about: str
    distance: str
    flight: LoopFlight
    estimation: LoopEstimation
    published: tuple[str, ...] = ()
    against: Against | None = None
    together: tuple[str, ...] = ()
    variants: tuple[Variant, ...] = ()
    stretch: tuple[float, float] | None = None
    peak: tuple[float, float] | None = None
    findings: str = ""
    methods: tuple[str, ...] = ()
    margins: MarginPlan | None = None
    seed: int = 1
    choices: tuple[Choice, ...] = ()
    seeds: int = 0

    @property
    def column(self) -> str:
        """The scenario's own column of the paper's tables; empty if there is none."""
        return self.published[0] if self.published else ""


# ---- Low-order equivalents published in NASA TM-101722

FILE = "short_period_dynamics.toml"
TURNED = ("delta", "L_delta", "M_delta", "delta_0")  # opposite sign in the paper


@dataclass(frozen=True)
class Printed:
    """A published value with the standard deviation from its published variance, if any."""

    value: float
    std: float | None


@dataclass(frozen=True)
class Range:
    """Published in the text: range of the EKF's estimates, value from the frequency response."""

    low: float
    high: float
    frequency_response: float


def printed_columns() -> tuple[str, ...]:
    """Return the names of the columns of the paper's tables."""
    return tuple(_document()["loes"])


def printed_column(name: str) -> dict[str, Printed]:
    """Return a column of the paper's tables: final estimates, SI. Empty without a name.

    Raises DeclarationError if there is no such column.
    """
    return _column("loes", name) if name else {}


def printed_start(name: str) -> dict[str, Printed]:
    """Return the initial state estimate and P0 of Table 1 (``simulation``) or 2 (``flight``), SI.

    Raises DeclarationError if there is none.
    """
    return _column("initial", name)


def printed_noise(name: str) -> dict[str, float]:
    """Return R of Table 1 or 2 as standard deviations, rad, rad/s and g.

    Raises DeclarationError if there is none.
    """
    rows = _table("measurement_noise", name)
    return standard_deviations(
        {}, {key: f"{row['value']} {row['unit']}" for key, row in rows.items()}, f"published {FILE}"
    )


def printed_density(name: str) -> dict[str, float]:
    """Return Q of Table 1 or 2 as printed.

    Raises DeclarationError if there is none.
    """
    return {key: float(row["value"]) for key, row in _table("process_noise", name).items()}


def printed_checks(name: str) -> dict[str, Range]:
    """Return the delay (s) and damping ratio that the text gives for a column; empty if none."""
    return {key: Range(**row) for key, row in _document()["checks"].get(name, {}).items()}


def printed_correlation(name: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names and correlation matrix ``(13, 13)`` of Table 1 or 2.

    Raises DeclarationError if there is none.
    """
    rows = _table("correlation", name)
    names = ("alpha", *rows)
    C = np.eye(len(names))
    for i, row in enumerate(rows.values(), start=1):
        C[i, :i] = C[:i, i] = row
    signs = np.array([-1.0 if name in TURNED else 1.0 for name in names])
    return names, C * np.outer(signs, signs)


def has_table(name: str) -> bool:
    """Return whether start, P0, R, Q and correlations of a column are published."""
    return name in _document()["initial"]


@cache
def _document() -> Mapping[str, Any]:
    return tomllib.loads(
        files("scenarios.studies").joinpath("published", FILE).read_text(encoding="utf-8")
    )


def _table(kind: str, name: str) -> Mapping[str, Any]:
    tables = _document()[kind]
    if name not in tables:
        raise DeclarationError(
            f"there is no column {name!r}",
            where=f"published {FILE}",
            remedy=f"use one of {', '.join(tables)}",
        )
    table: Mapping[str, Any] = tables[name]
    return table


def _column(kind: str, name: str) -> dict[str, Printed]:
    return {
        key: Printed(float(row["value"]), math.sqrt(row["variance"]) if "variance" in row else None)
        for key, row in _table(kind, name).items()
    }


# ---- From a closed-loop scenario's flight to its record

NO_LIMIT = 1e6  # deg/s, a rate that no actuator reaches


@dataclass(frozen=True, eq=False)
class SimulatedLoop:
    """A simulated flight: aircraft, record, and truth (None for a low-order truth)."""

    x29: X29
    record: Record
    truth: ClosedLoopTruth | None


def aircraft(flight: LoopFlight) -> X29:
    """Return the aircraft of a flight with the scenario's stick, limits and telemetry noise."""
    x29 = load_x29(flight.airframe)
    stick = x29.stick
    stick = stick if flight.dead_band is None else replace(stick, dead_band=flight.dead_band)
    stick = stick if flight.curvature is None else replace(stick, curvature=flight.curvature)
    if not flight.rate_limits:
        canard, flaperon, strake = (replace(surface, rate=NO_LIMIT) for surface in x29.surfaces)
        x29 = replace(x29, surfaces=(canard, flaperon, strake))
    std = {**telemetry_noise(x29), **flight.noise_std}
    telemetry = replace(
        x29.telemetry, alpha_noise=std["alpha"], q_noise=std["q"], nz_noise=std["nz"]
    )
    return replace(x29, stick=stick, telemetry=telemetry)


def telemetry_noise(x29: X29) -> dict[str, float]:
    """Return the standard deviations of the telemetry by output: rad, rad/s, g."""
    t = x29.telemetry
    return {"alpha": t.alpha_noise, "q": t.q_noise, "nz": t.nz_noise}


def stick_of(plan: StickPlan, duration: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the stick as a function of time."""
    if plan.kind == "3-2-1-1":
        return three_two_one_one(plan.amplitude, plan.unit, plan.start)
    if plan.kind == "doublet":
        return doublet(plan.amplitude, plan.unit, plan.start)
    if plan.kind == "levels":
        return SmoothStick(
            plan.times, tuple(plan.amplitude * level for level in plan.levels), plan.bandwidth
        )
    return manual_stick(
        np.random.default_rng(plan.pilot_seed), duration, plan.amplitude, plan.bandwidth, plan.start
    )


def fly_loop(flight: LoopFlight, seed: int) -> SimulatedLoop:
    """Simulate a flight and its record; the same seed gives the same bytes.

    Raises
    ------
    DeclarationError : the aircraft departs.
    """
    x29, rng = aircraft(flight), np.random.default_rng(seed)
    noise = rng if flight.noise else None
    record, truth = fly_closed_loop(
        x29, stick_of(flight.stick, flight.duration), flight.duration, noise
    )
    if truth.outcome is FlightOutcome.DEPARTED:
        raise DeclarationError(
            f"the aircraft departs at {truth.time[-1]:.3g} s",
            where="key flight",
            remedy="ask less of the stick",
        )
    if flight.low_order:
        record = _low_order_record(x29, record, flight, np.random.default_rng(seed))
    if flight.spike is not None:
        channel = record["stick"]
        values = channel.values.copy()
        values[int(np.argmin(np.abs(record.time - flight.spike.time)))] = flight.spike.size
        record = replace(record, inputs=(Channel.of("stick", channel.unit, values),))
    return SimulatedLoop(x29, record, None if flight.low_order else truth)


def low_order_model(x29: X29, values: dict[str, float]) -> Model:
    """Return the low-order equivalent system at the aircraft's flight condition.

    ``values``: parameters by the names of a vehicle file.
    """
    return model_from_constants("loes", loop_constants(x29), values)


def loop_constants(x29: X29) -> dict[str, float]:
    """Return the constants of the low-order equivalent by the names of a vehicle file, SI."""
    return {
        "airspeed": x29.airframe.airspeed,
        "gravity": x29.airframe.gravity,
        "vane_arm": x29.telemetry.vane_arm,
    }


def equivalent_values(equivalent: EquivalentSystem) -> dict[str, float]:
    """Return the eight numbers of an equivalent system by the names of a vehicle file."""
    names = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
    return {name: float(getattr(equivalent, name)) for name in names}


def short_period(values: Mapping[str, float]) -> tuple[float, float]:
    """Return undamped natural frequency (rad/s) and damping ratio of the short period.

    ``values``: L_alpha, L_q, M_alpha and M_q. NaN if the short period does not oscillate.
    """
    stiffness = values["L_alpha"] * values["M_q"] - values["L_q"] * values["M_alpha"]
    frequency = math.sqrt(stiffness) if stiffness > 0.0 else math.nan
    return frequency, -(values["L_alpha"] + values["M_q"]) / (2.0 * frequency)


def _low_order_record(
    x29: X29, record: Record, flight: LoopFlight, rng: np.random.Generator
) -> Record:
    """Return the record of the loop's low-order equivalent, with the recorded stick, held."""
    std = telemetry_noise(x29) if flight.noise else {}
    model = low_order_model(x29, equivalent_values(equivalent_system(x29)))
    model = model.with_noise(Noise(std, {"q": flight.gust} if flight.gust else {})).with_values(
        {"nz_0": 1.0}
    )
    values = record["stick"].values
    at = np.flatnonzero(np.diff(values, prepend=values[0] + 1.0))
    stick = MultiStep(tuple(values[at].tolist()), (*record.time[at].tolist(), math.inf))
    simulated, _ = fly(model, {"stick": stick}, record.time, rng, step=0.005, name=record.name)
    return replace(simulated, inputs=record.inputs)


# ---- The nonlinear loop against the linear one

# in, the largest deflection of each scaled stick; the last asks for some 6 g
STICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
RESPONSE_TOLERANCE = 1e-9  # relative error between two forms of the same loop
Change = Callable[[X29], X29]


@dataclass(frozen=True, eq=False)
class LinearCheck:
    """Relative misfits between nonlinear and linear response, as ratios of root mean squares.

    Attributes
    ----------
    time : ``(F,)`` s, frames of the control computer.
    simulated, linear : ``(3, F)``: alpha (rad), q (rad/s) and incremental nz (g), without noise.
    misfit : by output.
    apart : misfit of q with a single nonlinearity, by nonlinearity, and with none.
    stick : largest deflection, in.
    sticks : largest deflections of the same input at other amplitudes, in.
    curves : misfit of q at ``sticks``, with all and with some nonlinearities; NaN if the aircraft
        departs.
    limited : share of frames with an active command, rate or travel limit.
    """

    time: np.ndarray
    simulated: np.ndarray
    linear: np.ndarray
    misfit: Mapping[str, float]
    apart: Mapping[str, float]
    stick: float
    sticks: tuple[float, ...]
    curves: Mapping[str, tuple[float, ...]]
    limited: float

    @property
    def same(self) -> bool:
        """Whether only rounding remains without the nonlinearities."""
        return self.apart["none of these"] < RESPONSE_TOLERANCE


def linear_check(x29: X29, truth: ClosedLoopTruth) -> LinearCheck:
    """Compare a flight of ``x29`` with the linear response to the same stick.

    The stick must move the aircraft.
    """
    stick = truth.stick
    linear = respond(x29, stick)[1][:3]
    largest = float(np.abs(stick).max())
    limited = (truth.command_limited | truth.rate_limited | truth.stopped).any(axis=0)

    def q_misfit(change: Change, size: float = 1.0) -> float:
        """Return the misfit of q for a changed aircraft and a stick scaled by ``size``."""
        _, simulated = fly_closed_loop(change(x29), size * stick, float(truth.time[-1]))
        if simulated.outcome is not FlightOutcome.COMPLETED:
            return float("nan")
        return _relative_misfit(_motion(simulated)[1], size * linear[1])

    def limits_alone(x29: X29) -> X29:
        return _straight(_without_break_out(x29))

    simulated = _motion(truth)
    return LinearCheck(
        truth.time,
        simulated,
        linear,
        {
            name: _relative_misfit(flown, expected)
            for name, flown, expected in zip(OUTPUTS, simulated, linear, strict=True)
        },
        {
            "the break-out": q_misfit(lambda x: _straight(_unlimited(x))),
            "the gearing": q_misfit(lambda x: _without_break_out(_unlimited(x))),
            "the limits": q_misfit(limits_alone),
            "none of these": q_misfit(lambda x: _straight(_without_break_out(_unlimited(x)))),
        },
        largest,
        STICKS,
        {
            "as flown": tuple(q_misfit(lambda x: x, size / largest) for size in STICKS),
            "no break-out": tuple(q_misfit(_without_break_out, size / largest) for size in STICKS),
            "limits alone": tuple(q_misfit(limits_alone, size / largest) for size in STICKS),
        },
        float(limited.mean()),
    )


def linear_sentence(check: LinearCheck) -> str:
    """Return the sentence on the differences of the nonlinear loop, their causes, and what remains
    at a small stick.
    """
    text = ", ".join(f"{name} {_percent(value)}" for name, value in check.misfit.items())
    apart = ", ".join(f"{label} {_percent(value)}" for label, value in check.apart.items())
    small, free = check.curves["as flown"][0], check.curves["no break-out"][0]
    verdict = "two writings of one loop" if check.same else "NOT the same loop"
    return (
        "flown against the linear loop's forced response (python-control) to the same stick, root "
        f"mean square over the response's: {text}; "
        f"with one departure from linearity at a time q differs by: {apart} ({verdict}); a limit "
        f"is met in {100.0 * check.limited:.2g} % of "
        f"the frames; at a stick of {check.sticks[0]:g} in at most q differs by {_percent(small)}, "
        f"without the break-out by {_percent(free)}"
    )


def _motion(truth: ClosedLoopTruth) -> np.ndarray:
    return np.stack([truth.alpha, truth.q, truth.nz - 1.0])


def _relative_misfit(simulated: np.ndarray, linear: np.ndarray) -> float:
    return float(np.linalg.norm(simulated - linear) / np.linalg.norm(linear))


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "unknown (it departs)"
    form = ".0e" if share < RESPONSE_TOLERANCE else ".2g" if share < 0.99 else ".0f"
    return f"{100.0 * share:{form}} %"


def _without_break_out(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, dead_band=0.0))


def _straight(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, curvature=0.0))


def _unlimited(x29: X29) -> X29:
    canard, flaperon, strake = (
        replace(surface, rate=NO_LIMIT, lower=-NO_LIMIT, upper=NO_LIMIT) for surface in x29.surfaces
    )
    return replace(x29, surfaces=(canard, flaperon, strake))
