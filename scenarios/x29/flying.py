"""From a closed-loop scenario's flight to its record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scenarios.x29.declaration import LoopFlight, StickPlan
from sim.closed_loop.airframe import X29, load_x29
from sim.closed_loop.linear import EquivalentSystem, equivalent_system
from sim.closed_loop.nonlinear import ClosedLoopTruth, FlightOutcome, SmoothStick, doublet, fly_closed_loop, hand_flown, three_two_one_one
from sim.declaration.model import Model, Noise
from sim.errors import DeclarationError
from sim.maneuvers import MultiStep
from sim.record import Channel, Record
from sim.truth.flight import fly
from sim.vehicles.factory import model_from_constants

NO_LIMIT = 1e6  # deg/s, a rate that no ram reaches


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight: the aircraft as it flew, its telemetry, and what really happened (None where a low-order truth was flown)."""

    x29: X29
    record: Record
    truth: ClosedLoopTruth | None


def aircraft(flight: LoopFlight) -> X29:
    """The aircraft of a flight with the scenario's stick, limits and telemetry noise."""
    x29 = load_x29(flight.airframe)
    stick = x29.stick
    stick = stick if flight.dead_band is None else replace(stick, dead_band=flight.dead_band)
    stick = stick if flight.curvature is None else replace(stick, curvature=flight.curvature)
    if not flight.rate_limits:
        canard, flaperon, strake = (replace(surface, rate=NO_LIMIT) for surface in x29.surfaces)
        x29 = replace(x29, surfaces=(canard, flaperon, strake))
    t, noise = x29.telemetry, flight.noise_std
    std = (noise.get("alpha", t.alpha_noise), noise.get("q", t.q_noise), noise.get("nz", t.nz_noise))
    telemetry = replace(t, alpha_noise=std[0], q_noise=std[1], nz_noise=std[2])
    return replace(x29, stick=stick, telemetry=telemetry)


def stick_of(plan: StickPlan, duration: float) -> Callable[[np.ndarray], np.ndarray]:
    """The stick as a function of time."""
    if plan.kind == "3-2-1-1":
        return three_two_one_one(plan.amplitude, plan.unit, plan.start)
    if plan.kind == "doublet":
        return doublet(plan.amplitude, plan.unit, plan.start)
    if plan.kind == "levels":
        return SmoothStick(plan.times, tuple(plan.amplitude * level for level in plan.levels), plan.bandwidth)
    return hand_flown(np.random.default_rng(plan.pilot_seed), duration, plan.amplitude, plan.bandwidth, plan.start)


def fly_loop(flight: LoopFlight, seed: int) -> Flown:
    """Fly and record; the same seed gives the same bytes.

    Raises
    ------
    DeclarationError : the aircraft departs.
    """
    x29, rng = aircraft(flight), np.random.default_rng(seed)
    noise = rng if flight.noise else None
    record, truth = fly_closed_loop(x29, stick_of(flight.stick, flight.duration), flight.duration, noise)
    if truth.outcome is FlightOutcome.DEPARTED:
        raise DeclarationError(f"the aircraft departs at {truth.time[-1]:.3g} s", where="key flight", remedy="ask less of the stick")
    if flight.low_order:
        record = _low_order_record(x29, record, flight, np.random.default_rng(seed))
    if flight.spike is not None:
        channel = record["stick"]
        values = channel.values.copy()
        values[int(np.argmin(np.abs(record.time - flight.spike.time)))] = flight.spike.size
        record = replace(record, inputs=(Channel.of("stick", channel.unit, values),))
    return Flown(x29, record, None if flight.low_order else truth)


def low_order_model(x29: X29, values: dict[str, float]) -> Model:
    """The low-order equivalent system at the aircraft's flight condition; ``values`` by the names of a vehicle file."""
    constants = {"airspeed": x29.airframe.airspeed, "gravity": x29.airframe.gravity, "vane_arm": x29.telemetry.vane_arm}
    return model_from_constants("loes", constants, values)


def equivalent_values(found: EquivalentSystem) -> dict[str, float]:
    """The eight numbers of an equivalent system by the names of a vehicle file."""
    names = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
    return {name: float(getattr(found, name)) for name in names}


def _low_order_record(x29: X29, record: Record, flight: LoopFlight, rng: np.random.Generator) -> Record:
    """The same stick flown by the loop's own low-order equivalent, its record's stick held."""
    t = x29.telemetry
    std = {"alpha": t.alpha_noise, "q": t.q_noise, "nz": t.nz_noise} if flight.noise else {}
    model = low_order_model(x29, equivalent_values(equivalent_system(x29)))
    model = model.with_noise(Noise(std, {"q": flight.gust} if flight.gust else {})).with_values({"nz_0": 1.0})
    flown, _ = fly(model, {"stick": _as_recorded(record)}, record.time, rng, step=0.005, name=record.name)
    return replace(flown, inputs=record.inputs)


def _as_recorded(record: Record) -> MultiStep:
    """The recorded stick, held between its samples."""
    values = record["stick"].values
    at = np.flatnonzero(np.diff(values, prepend=values[0] + 1.0))
    return MultiStep(tuple(values[at].tolist()), (*record.time[at].tolist(), float("inf")))
