"""A case's records: flown with what is hidden, measured, and spoiled by the recorder where that is
what is hidden.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exam.hidden_terms.library import find_any_term
from exam.random_cases.case import Case, Setting
from exam.random_cases.kinds import KINDS
from exam.random_cases.vehicles import CONTROL, NOISE, Flight, as_sampled
from sim.declaration.effect import full_name
from sim.declaration.model import Model, Noise
from sim.errors import ModelError
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times

STEP = 0.002  # s, of the integration
STEEPEST = 0.4  # rad of alpha: perturbations about trim describe no more, and nobody flies on
Values = Mapping[str, Mapping[str, float]]


def drawn_values(hidden: tuple[str, ...], setting: Setting, rng: np.random.Generator) -> Values:
    """Parameters of what is hidden in the first record."""
    return {name: KINDS[name].draw(rng, setting) for name in hidden}


def values_again(
    hidden: tuple[str, ...], first: Values, setting: Setting, rng: np.random.Generator
) -> Values:
    """Those in the second record: drawn anew for what belongs to one record, but what belongs to
    the vehicle.
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
    """One record with noise, as it comes out of the recorder.

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
    """The same without noise and recorder, some of the vehicle's parameters ``changed``; ``step``
    of the integration in s.
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
    # Only simulated spikes ask how long the record and a sample are.
    known = {
        **({"duration": setting.duration, "width": setting.interval} if "spikes" in name else {}),
        **drawn,
    }
    return model.with_effects(effect).with_values(
        {full_name(effect, key): value for key, value in known.items() if key in local}
    )
