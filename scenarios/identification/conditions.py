"""Conditions of an identification: frequency bands and recorded pitch attitude.

A recorded pitch attitude theta is an input of the effect phugoid: u_dot = -g (theta - alpha). Each
record has its initial flight-path angle as a further unknown. The records decide whether the effect
is used: it does not act in a wind tunnel, on a rig or in a simulation at constant speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate
from ident.frequency_domain.output_error import (
    FrequencySettings,
    band_for,
    fit_frequency_domain,
    refuse_unfit,
)
from ident.whole_record.layout import FitSettings
from scenarios.identification.assessment import simulated
from scenarios.preparation.declared_model import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    compared_interpretations,
)
from scenarios.preparation.plan import ATTITUDE
from sim.declaration.compile import compile_model
from sim.declaration.effect import full_name
from sim.declaration.model import Model, System
from sim.effects.disturbance.airspeed import Phugoid
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import DeclarationError
from sim.record import Record

# ---- The frequency domain for a model and its records

METHOD = "frequency-domain"


def delays_of(model: Model) -> dict[str, str]:
    """Return the delay parameter of each delayed input."""
    return {
        effect.signal: full_name(effect, "delay")
        for effect in model.effects
        if isinstance(effect, InputDelay)
    }


def refuse_band(band: tuple[float, float] | None, method: str) -> None:
    """Raise DeclarationError if the method has no band, or the band is empty or infinite."""
    if band is None:
        return
    if method != METHOD:
        raise DeclarationError(
            f"{method} has no band of frequencies",
            where="--band",
            remedy=f"use it with --method {METHOD}, or leave it out",
        )
    low, high = band
    if not (math.isfinite(high) and 0.0 <= low < high):
        raise DeclarationError(
            f"{low:g} to {high:g} Hz is no band",
            where="--band",
            remedy="give the lower frequency first, in Hz",
        )


def chosen_band(
    records: Sequence[Record],
    model: Model,
    outputs: Sequence[str],
    band: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return the requested band, or without one the band of the data, Hz.

    Raises ModelError if the model has no frequency response.
    """
    system = compile_model(model, outputs)
    refuse_unfit(records, system, delays_of(model))
    return band or band_for(records, system)


def estimated(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    delays: Mapping[str, str],
    band: tuple[float, float] | None,
) -> Estimate:
    """Return the estimate of the frequency domain, with ``fitted`` from a free simulation."""
    estimate = fit_frequency_domain(
        records, system, FrequencySettings(band, settings.use_priors), delays=delays
    )
    rows = [simulated(record, system, estimate.as_dict(), settings) for record in records]
    shown = tuple(
        blank if row is None else row for row, blank in zip(rows, estimate.fitted, strict=True)
    )
    return replace(estimate, fitted=tuple(np.asarray(row) for row in shown))


# ---- A recorded pitch attitude in the identification of a rigid aircraft

PATH = "phugoid.attitude"


def with_weight(model: Model) -> Model:
    """Return the model with the component of the weight along the flight path.

    The initial flight-path angle is free; the drag polar has typical values.
    """
    with_phugoid = model.with_effects(Phugoid(attitude_recorded=True))
    held = [
        name
        for name in with_phugoid.parameters.names
        if name.startswith("phugoid.") and name != PATH
    ]
    return with_phugoid.with_parameters(with_phugoid.parameters.hold(held))


def with_weight_if_needed(
    model: Model, records: Sequence[Record], outputs: Sequence[str]
) -> tuple[Model, str]:
    """Return the model with the weight along the flight path if the records prefer it, and a note.

    The note is empty if no attitude is recorded.
    """
    if ATTITUDE not in {signal.name for signal in model.equations.inputs}:
        return model, ""
    wider = with_weight(model)
    found = compared_interpretations(
        (model, list(records)), (wider, list(records)), outputs, local=[PATH]
    )
    gain = found.gain
    if found.why_open:
        return (
            model,
            "the pitch attitude is measured and not used: fits with and without the weight along "
            f"the flight path decide nothing ({found.why_open})",
        )
    if gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        return (
            model,
            "the pitch attitude is measured and not used: the weight along the flight path "
            f"explains no more (likelihood ratio test: {gain:.1f}, "
            f"{DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)",
        )
    return (
        wider,
        "the pitch attitude is measured: the weight along the flight path changes speed and loads "
        f"(likelihood ratio test: {gain:.1f}, {DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)",
    )


def without_theta(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record]]:
    """Return the model and records without an unused attitude input."""
    inputs = tuple(signal for signal in model.equations.inputs if signal.name != ATTITUDE)
    bare = [
        replace(
            record, inputs=tuple(channel for channel in record.inputs if channel.name != ATTITUDE)
        )
        for record in records
    ]
    return replace(model, equations=replace(model.equations, inputs=inputs)), bare  # type: ignore[type-var]
