"""The records of a case: flown with the hidden cause, measured, and spoiled by the recorder; and
whether the cause is observable in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from exam.hidden_terms.library import find_any_term
from exam.random_cases.case import Case, Setting
from exam.random_cases.kinds import KINDS
from exam.random_cases.vehicles import CONTROL, NOISE, Flight, as_sampled, estimated
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.model import Model, Noise
from sim.errors import ModelError
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times

# ---- A case's records

STEP = 0.002  # s, integration step
# rad, largest alpha that perturbations about trim describe; nobody would fly on.
STEEPEST = 0.4
Values = Mapping[str, Mapping[str, float]]


def drawn_values(hidden: tuple[str, ...], setting: Setting, rng: np.random.Generator) -> Values:
    """Draw the parameters of the hidden causes in the first record."""
    return {name: KINDS[name].draw(rng, setting) for name in hidden}


def values_again(
    hidden: tuple[str, ...], first: Values, setting: Setting, rng: np.random.Generator
) -> Values:
    """Return the parameters in the second record: those of the vehicle are the same, those of a
    record are drawn again.
    """

    def again(name: str) -> Mapping[str, float]:
        if not KINDS[name].apart:
            return first[name]
        return {
            **KINDS[name].draw(rng, setting),
            **{local: first[name][local] for local in KINDS[name].same},
        }

    return {name: again(name) for name in hidden}


def flown(case: Case, values: Values, flight: Flight, rng: np.random.Generator) -> Record:
    """Fly one record with noise and with the faults of the recorder.

    Raises
    ------
    ModelError : what is hidden takes the aircraft beyond what perturbations about trim describe.
    """
    record = simulated(case, values, flight, rng, {})
    if "alpha" in case.channels and np.max(np.abs(record["alpha"].values)) > STEEPEST:
        raise ModelError(
            f"alpha exceeds {STEEPEST:g} rad",
            where=f"case {case.seed}",
            remedy="draw what is hidden anew",
        )
    outputs = (
        Channel.of(c.name, c.unit, c.values + NOISE[c.name] * rng.standard_normal(len(record)))
        for c in record.outputs
    )
    record = Record(record.time, record.inputs, tuple(outputs), record.hold, record.name)
    for name, drawn in values.items():
        spoils = KINDS[name].spoils
        record = record if spoils is None else spoils(record, drawn, rng)
    return record


def simulated(
    case: Case,
    values: Values,
    flight: Flight,
    rng: np.random.Generator,
    changed: Mapping[str, float],
    *,
    step: float = STEP,
) -> Record:
    """Fly one record without noise and recorder.

    ``changed`` has changed parameters of the vehicle, and ``step`` is the integration step in s.
    """
    setting = flight.setting
    true = setting.model.with_noise(Noise()).with_values(changed)
    for name, drawn in values.items():
        if KINDS[name].term:
            true = _with_term(true, name, drawn, setting)
    time = sample_times(case.rate, setting.duration)
    inputs = (
        {CONTROL[case.model]: as_sampled(flight.maneuver, time, setting.interval)}
        if flight.maneuver is not None
        else None
    )
    return fly(true, inputs, time, rng, step=step, outputs=case.channels)[0]


def _with_term(model: Model, name: str, drawn: Mapping[str, float], setting: Setting) -> Model:
    effect = find_any_term(KINDS[name].term, model.equations, name)
    local = {item.name for item in effect.parameters}
    # Only simulated spikes have the durations of the record and of a sample as parameters.
    known = {
        **({"duration": setting.duration, "width": setting.interval} if "spikes" in name else {}),
        **drawn,
    }
    return model.with_effects(effect).with_values(
        {full_name(effect, key): value for key, value in known.items() if key in local}
    )


# ---- Can what is hidden be seen in the record that is fitted? An effect below the noise, or wit

LEAST = 40.0  # log likelihood: at that strength the weak effects of ``detection`` are all detected
COARSE = 4.0 * STEP  # s
SLOPE = 1e-3  # step of a difference, relative to the value of a parameter or a state
LEAST_STATE = 0.1  # rad, rad/s; replaces the value of a state that begins at zero


def all_visible(case: Case, values: Values, flight: Flight) -> bool:
    """Return whether each hidden effect of a record is observable.

    Random effects and faults of the recorder are not tested.
    """
    asked = [name for name in values if _is_smooth(name, flight)]
    if not asked:
        return True
    true = _whitened(case, values, flight, {})
    model = flight.setting.model
    columns = [np.kron(np.eye(len(true)), np.ones((true.shape[1], 1)))]
    for name in estimated(case.model):
        change = SLOPE * model.parameters[name].value
        columns.append(
            (
                _whitened(case, values, flight, {name: model.parameters[name].value + change})
                - true
            ).reshape(-1, 1)
            / SLOPE
        )
    for item in model.initial:
        moved = model.with_initial(
            model.initial.with_values(
                {item.name: item.value + SLOPE * max(abs(item.value), LEAST_STATE)}
            )
        )
        elsewhere = replace(flight, setting=replace(flight.setting, model=moved))
        there = _whitened(case, values, elsewhere, {})
        if there.shape == true.shape:
            columns.append((there - true).reshape(-1, 1) / SLOPE)
    without = {
        name: _whitened(case, {k: v for k, v in values.items() if k != name}, flight, {})
        for name in asked
    }
    if any(there.shape != true.shape for there in without.values()):
        return False  # it cannot be flown with all of them, or without one
    gone = {name: (there - true).reshape(-1, 1) for name, there in without.items()}
    return all(
        _left([*columns, *(other for key, other in gone.items() if key != name)], gone[name])
        > LEAST
        for name in asked
    )


def _left(columns: list[np.ndarray], change: np.ndarray) -> float:
    """Return half the square of the part of a change that the columns do not explain."""
    basis = np.concatenate(columns, axis=1)
    basis = basis / (np.linalg.norm(basis, axis=0) + 1e-300)
    rest = change - basis @ np.linalg.lstsq(basis, change, rcond=1e-9)[0]
    return 0.5 * float(np.sum(rest**2))


def _is_smooth(name: str, flight: Flight) -> bool:
    """Return whether a kind acts in the flight and is not random.

    Spikes and turbulence are observable alone or not at all.
    """
    kind = KINDS[name]
    if not kind.term or "spikes" in kind.term:
        return False
    return not isinstance(
        find_any_term(kind.term, flight.setting.model.equations, name), NoiseEffect
    )


def _whitened(case: Case, values: Values, flight: Flight, changed: dict[str, float]) -> np.ndarray:
    """Return the outputs without noise, in noise sigmas, ``(channels, N)``, with some parameters of
    the aircraft changed.

    They are zero if the flight is not possible.
    """
    smooth = {name: drawn for name, drawn in values.items() if _is_smooth(name, flight)}
    try:
        record = simulated(case, smooth, flight, np.random.default_rng(0), changed, step=COARSE)
    except ModelError:
        return np.zeros((len(case.channels), 1))
    return np.stack([channel.values / NOISE[channel.name] for channel in record.outputs])
