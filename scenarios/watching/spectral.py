"""On-line identification in the frequency domain, with an estimate every second.

For models whose states are measured, and in addition to the filter bank of the low-order equivalent
system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.modes import modal_estimate
from ident.frequency_domain.online import (
    OnlineEquations,
    Sums,
    advance,
    empty_sums,
    online_equations,
)
from ident.frequency_domain.online_regression import (
    LagStream,
    OnlineEstimate,
    estimate,
    estimated,
    lag_stream,
    with_rows,
)
from scenarios.files.user_models import channel_units, moves_about_rest
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.cautions import contradicted
from scenarios.identification.low_order import derived_of
from scenarios.preparation.declared_model import DECISIVE_LOG_LIKELIHOOD_RATIO, model_of_file
from scenarios.preparation.measured_inputs import (
    MEASURED,
    Flow,
    flow_doubts,
    flow_rows,
    flow_sentence,
    measured_flow,
    pressure_at_rest,
    usable_flow_channels,
    with_flow_inputs,
)
from scenarios.preparation.plan import BY_HAND
from scenarios.studies.comparison import estimate_content
from scenarios.studies.declaration import rows_of
from scenarios.watching.rows import LOES, StreamSignals
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import model_from_constants

METHOD = "frequency-domain"
UNKNOWN = "not determined"
SECOND_TOLERANCE = 1e-9  # s, tolerance of the first row of a second


@dataclass(frozen=True, eq=False)
class Point:
    """Estimate after a second of the stream.

    Attributes
    ----------
    time : time of the last row, s.
    values, std : values and standard deviations of the q parameters, ``(q,)``; the standard
        deviation is infinite if a parameter is not determined.
    """

    time: float
    values: np.ndarray
    std: np.ndarray


@dataclass
class SpectralSession:
    """State of an on-line regression in the frequency domain; ``take`` changes it.

    Attributes
    ----------
    vehicle : the vehicle file.
    name : name of the stream.
    signals : inputs and outputs, in the order of the rows after time.
    system, declared : the model compiled and as declared.
    readings : equations and sums of the regression by hold of the inputs.
    hold : hold of the inputs in the last estimate.
    gain : twice the log-likelihood ratio of linear to held inputs.
    flow : names of the measured airspeed and pressure that are used as inputs.
    level : initial pressure, Pa; None before it is known.
    lag : regression of the low-order equivalent system, in place of ``readings``.
    last : the last estimate of the regression.
    waiting : rows of an incomplete second, in blocks ``(1 + r + m, n)``.
    blocks : rows of the seconds that are regressed, in blocks of the same shape.
    points : estimates, one per second.
    begun : time of the first row, s.
    hold_from : words on the origin of ``hold`` if only one hold is used.
    """

    vehicle: VehicleFile
    name: str
    signals: StreamSignals
    system: System
    declared: Model
    readings: dict[Hold, tuple[OnlineEquations, Sums]] = field(default_factory=dict)
    hold: Hold = Hold.PREVIOUS
    gain: float = 0.0
    flow: tuple[str, ...] = ()
    level: float | None = None
    lag: LagStream | None = None
    last: OnlineEstimate | None = None
    waiting: list[np.ndarray] = field(default_factory=list)
    blocks: list[np.ndarray] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    begun: float | None = None
    hold_from: str = BY_HAND

    @property
    def regressed(self) -> OnlineEquations:
        """The regressed equations; those of the low-order equivalent at fixed lag and delay."""
        return self.readings[self.hold][0] if self.lag is None else self.lag.equations

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return self.regressed.names if self.lag is None else self.lag.names

    @property
    def rows(self) -> int:
        """Number of rows so far."""
        return sum(block.shape[1] for block in (*self.blocks, *self.waiting))


def signals_of(vehicle: VehicleFile) -> StreamSignals:
    """Return inputs and outputs that a stream may have for the model of a vehicle file."""
    model = model_of_file(vehicle)
    inputs = tuple(signal.name for signal in model.equations.inputs)
    outputs = [signal.name for signal in model.equations.outputs]
    flow = [name for name in usable_flow_channels(model) if name not in outputs]
    return StreamSignals(inputs, (*outputs, *flow), channel_units(model))


def spectral_session(
    vehicle: VehicleFile,
    name: str,
    outputs: Sequence[str],
    omega: np.ndarray,
    hold: Hold | None = None,
    hold_from: str = BY_HAND,
) -> SpectralSession:
    """Return a session for the outputs of a stream.

    Parameters
    ----------
    vehicle : the vehicle file.
    name : name of the stream.
    outputs : names of the outputs that the stream has.
    omega : frequencies, rad/s.
    hold : hold of the inputs between rows; None: the more likely hold.
    hold_from : words on the origin of the hold.

    Raises
    ------
    ModelError : the equations cannot be regressed on line.
    DeclarationError : parameters are tied.
    """
    if vehicle.model == "loes":
        declared = model_from_constants("loes", vehicle.constants, vehicle.derivatives)
        system = compile_model(declared)
        return SpectralSession(
            vehicle, name, LOES, system, declared, lag=lag_stream(system, omega, outputs)
        )
    declared = model_of_file(vehicle)
    if declared.ties:
        what, remedy = "a regression on line knows no ties", "leave [tied] out, or use identify"
        raise DeclarationError(what, where=vehicle.name, remedy=remedy)
    system = compile_model(declared)
    flow = tuple(
        name
        for name in usable_flow_channels(declared)
        if name in outputs and name not in system.output_names
    )
    regressed = with_flow_inputs(declared, density=set(flow) == set(MEASURED)) if flow else declared
    equations = online_equations(compile_model(regressed), omega, outputs)
    holds = (hold,) if hold is not None else tuple(Hold) if system.inputs else (Hold.PREVIOUS,)
    readings = {kind: (replace(equations, hold=kind), empty_sums(equations)) for kind in holds}
    return SpectralSession(
        vehicle,
        name,
        signals_of(vehicle),
        system,
        declared,
        readings,
        holds[0],
        flow=flow,
        hold_from=hold_from,
    )


def take(session: SpectralSession, rows: np.ndarray) -> list[Point]:
    """Take rows, ``(1 + r + m, N)``, and return the estimates after each complete second.

    Rows are time, inputs and outputs. Results do not depend on the pieces in which rows arrive.
    """
    if rows.shape[1] == 0:
        return []
    if session.begun is None:
        session.begun = float(rows[0, 0])
    cuts = np.flatnonzero(np.diff(np.floor(rows[0] - session.begun + SECOND_TOLERANCE))) + 1
    points = []
    for part in np.split(rows, cuts, axis=1):
        if session.waiting:
            before = session.waiting[-1][0, -1] - session.begun + SECOND_TOLERANCE
            if np.floor(part[0, 0] - session.begun + SECOND_TOLERANCE) > np.floor(before):
                points += regress(session)
        session.waiting.append(part)
    return points


def regress(session: SpectralSession) -> list[Point]:
    """Regress the waiting rows and return the estimate; empty if nothing is determined yet."""
    if not session.waiting:
        return []
    block = np.concatenate(session.waiting, axis=1)
    session.waiting = []
    session.blocks.append(block)
    assert session.begun is not None
    time = block[0] - session.begun
    r = len(session.signals.inputs)
    m = len(session.system.output_names)
    inputs, outputs = block[1 : 1 + r], block[1 + r : 1 + r + m]
    if session.flow:
        inputs = np.concatenate([inputs, _flow_rows(session)])
    values = None if session.last is None else session.last.values
    if session.lag is not None:
        session.lag = with_rows(session.lag, time, inputs[0], outputs, values)
        equations, session.lag = estimated(session.lag)
    else:
        equations = _likelier(session, time, inputs, outputs, values)
    if equations is None or not np.all(np.isfinite(equations.values)):
        return []
    session.last = equations
    session.points.append(Point(float(block[0, -1]), equations.values, equations.std))
    return session.points[-1:]


def _flow_rows(session: SpectralSession) -> np.ndarray:
    """Return changes of airspeed and pressure in the last second, ``(k, N)``.

    They are smoothed over the last two seconds.
    """
    recent = session.blocks[-2:]
    table = np.concatenate(recent, axis=1)
    first = 1 + len(session.signals.inputs)
    units = session.signals.channel_units
    measured = [(name, table[first + session.signals.outputs.index(name)]) for name in session.flow]
    channels = tuple(
        Channel.of(name, units[name], row) for name, row in measured if np.isfinite(row).any()
    )
    model, new_rows = session.declared, recent[-1].shape[1]
    flow = None
    if len(channels) == len(session.flow) and table.shape[1] > 1:
        flow = measured_flow(Record(table[0], (), channels, name=session.name), model)
    if flow is None:
        flow = Flow(np.full(table.shape[1], model.parameters["airspeed"].value), None)
    elif session.level is None:
        session.level = pressure_at_rest(table[0], flow, model)
    level = session.level or pressure_at_rest(table[0], flow, model)
    rows = flow_rows(flow, model, level)
    names = session.regressed.system.inputs[len(session.signals.inputs) :]
    return np.array([rows[signal.name][-new_rows:] for signal in names])


def _likelier(
    session: SpectralSession,
    time: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    values: np.ndarray | None,
) -> OnlineEstimate | None:
    """Add rows to the sums of each hold, and return the estimate of the more likely hold.

    Inputs are held unless the rows are decisively more likely with linear inputs.
    """
    found: dict[Hold, OnlineEstimate | None] = {}
    for kind, (equations, sums) in session.readings.items():
        sums = advance(equations, sums, time, inputs, outputs, values)
        session.readings[kind] = equations, sums
        found[kind] = estimate(equations, sums)
    held, linear = found.get(Hold.PREVIOUS), found.get(Hold.LINEAR)
    if held is not None and linear is not None:
        session.gain = 2.0 * (held.cost - linear.cost)
        session.hold = (
            Hold.LINEAR if session.gain >= DECISIVE_LOG_LIKELIHOOD_RATIO else Hold.PREVIOUS
        )
    return found[session.hold]


def stream_notes(session: SpectralSession) -> list[str]:
    """Return notes on the hold of the inputs and on the use of a measured airspeed."""
    if session.lag is not None or session.last is None:
        return []
    sentences = [flow_sentence(record_of(session), session.declared)] if session.flow else []
    if session.system.inputs and len(session.readings) == 1:
        word = "held" if session.hold is Hold.PREVIOUS else "linear"
        sentences.append(f"inputs {word} between samples: {session.hold_from}")
    elif session.hold is Hold.LINEAR:
        sentences.append(
            "inputs linear between samples: they explain the stream better than held ones (twice "
            f"the log likelihood {session.gain:.1f}); --hold previous holds them"
        )
    return sentences


def stream_warnings(session: SpectralSession) -> list[str]:
    """Return warnings: parameters that are not determined or contradict the vehicle file, and a
    measured airspeed far from the declared one.
    """
    unknown = undetermined(session)
    sentences = [f"{UNKNOWN} by this stream: {', '.join(unknown)}"] if unknown else []
    if session.lag is None and (latest := last_estimate(session)) is not None:
        starts = {item.name: item.value for item in session.system.parameters}
        if doubt := contradicted(rows_of(latest), starts):
            sentences.append(doubt)
    return sentences + (flow_doubts([record_of(session)], session.declared) if session.flow else [])


def record_of(session: SpectralSession) -> Record:
    """Return the rows so far as a record. Raises RecordError if there are fewer than two."""
    blocks = [*session.blocks, *session.waiting]
    table = np.concatenate(blocks, axis=1) if blocks else np.zeros((len(session.signals.names), 0))
    if table.shape[1] < 2:
        what = f"{table.shape[1]} row(s) that can be used"
        raise RecordError(what, where=session.name, remedy="a stream needs at least two")
    r, units = len(session.signals.inputs), session.signals.channel_units
    inputs = tuple(
        Channel.of(name, units[name], row)
        for name, row in zip(session.signals.inputs, table[1 : 1 + r], strict=True)
    )
    outputs = [
        (name, row)
        for name, row in zip(session.signals.outputs, table[1 + r :], strict=True)
        if np.isfinite(row).any()
    ]
    return Record(
        table[0],
        inputs,
        tuple(Channel.of(name, units[name], row) for name, row in outputs),
        session.hold,
        session.name,
    )


def last_estimate(session: SpectralSession) -> Estimate | None:
    """Return the last estimate of the determined parameters; None without any."""
    result, names = session.last, session.names
    if result is None:
        return None
    finite = [k for k in range(len(names)) if np.isfinite(result.std[k]) and result.std[k] > 0.0]
    if not finite:
        return None
    units = tuple(session.system.parameters[names[k]].unit for k in finite)
    noise = np.sqrt(np.mean(result.levels, axis=1))
    return Estimate(
        METHOD,
        tuple(names[k] for k in finite),
        units,
        result.values[finite],
        result.covariance[np.ix_(finite, finite)],
        Outcome.CONVERGED,
        -result.cost,
        session.regressed.labels,
        noise,
        (),
    )


def undetermined(session: SpectralSession) -> list[str]:
    """Return the parameters that the stream does not determine."""
    latest = last_estimate(session)
    return [name for name in session.names if latest is None or name not in latest.names]


def derived_quantities(
    session: SpectralSession, latest: Estimate
) -> dict[str, tuple[float, float]]:
    """Return quantities such as natural frequency and damping, with their standard deviations.

    Empty if a parameter is not determined or the model has no such quantities.
    """
    if undetermined(session):
        return {}
    if session.lag is not None:
        delay = latest.value("delay"), latest.sigma("delay")
        return {**derived_of(latest, session.vehicle, delay), "delay": delay}
    return modal_estimate(session.system, latest) if moves_about_rest(session.declared) else {}


def history_csv(session: SpectralSession) -> str:
    """Return the estimates as CSV, a line for each second.

    Columns are ``time``, and ``NAME`` and ``NAME_std`` of each parameter; a cell is empty if the
    parameter is not determined.
    """
    lines = [
        ",".join(["time", *(cell for name in session.names for cell in (name, f"{name}_std"))])
    ]
    for point in session.points:
        cells = [f"{point.time:.10g}"]
        for value, std in zip(point.values.tolist(), point.std.tolist(), strict=True):
            cells += [f"{value:.10g}", f"{std:.10g}"] if np.isfinite(std) else ["", ""]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def estimate_of(point: Point, session: SpectralSession) -> list[dict[str, Any]]:
    """Return name, value, std and unit of the determined parameters, best determined first."""
    rows = []
    for name, value, std in zip(
        session.names, point.values.tolist(), point.std.tolist(), strict=True
    ):
        if np.isfinite(std) and std > 0.0:
            unit = session.system.parameters[name].unit
            rows.append({"name": name, "value": value, "std": std, "unit": unit})
    return sorted(rows, key=lambda row: row["std"] / max(abs(row["value"]), 1e-300))


def spectral_content(session: SpectralSession) -> dict[str, Any]:
    """Return the last estimate for ``comparison.json``."""
    latest, unknown = last_estimate(session), undetermined(session)
    if latest is None:
        outcome = Outcome.NOT_IDENTIFIABLE
        return {
            "method": METHOD,
            "parameters": {},
            "fixed": {},
            "derived": {},
            "outcome": outcome.code,
            "outcome_sentence": outcome.value,
            "undetermined": unknown,
            "warnings": stream_warnings(session),
        }
    fixed = {
        parameter.name: (parameter.value, parameter.unit)
        for parameter in session.system.parameters
        if not parameter.free
        and not parameter.name.startswith("bias_")
        and parameter.name not in latest.names
    }
    derived = derived_quantities(session, latest)
    content = estimate_content(latest, rows_of(latest), derived, fixed, ())
    lists = {
        "undetermined": unknown,
        "warnings": stream_warnings(session),
        "notes": stream_notes(session),
    }
    return {
        **content,
        "method": METHOD,
        "band_Hz": (session.regressed.omega[[0, -1]] / (2.0 * np.pi)).tolist(),
        **{key: entries for key, entries in lists.items() if entries},
    }
