"""The frequency domain for a model and its records: which delays there are, what the band may be, and a fit with its response in time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate
from ident.frequency_domain.output_error import FrequencySettings, band_for, fit_frequency_domain, refuse_unfit
from ident.whole_record.layout import FitSettings
from scenarios.identification.assessment.prediction import simulated
from sim.declaration.compile import compile_model
from sim.declaration.effect import full_name
from sim.declaration.model import Model, System
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import DeclarationError
from sim.record import Record

METHOD = "frequency-domain"


def delays_of(model: Model) -> dict[str, str]:
    """Input -> the parameter by which it is late, of a model with delays on its inputs."""
    return {effect.signal: full_name(effect, "delay") for effect in model.effects if isinstance(effect, InputDelay)}


def refuse_band(band: tuple[float, float] | None, method: str) -> None:
    """Raise DeclarationError for a band of another method, or one that is none."""
    if band is None:
        return
    if method != METHOD:
        raise DeclarationError(f"{method} has no band of frequencies", where="--band", remedy=f"use it with --method {METHOD}, or leave it out")
    low, high = band
    if not (math.isfinite(high) and 0.0 <= low < high):
        raise DeclarationError(f"{low:g} to {high:g} Hz is no band", where="--band", remedy="give the lower frequency first, in Hz")


def chosen_band(records: Sequence[Record], model: Model, outputs: Sequence[str], band: tuple[float, float] | None) -> tuple[float, float]:
    """The band that is asked for, else the data's own, Hz. Raises ModelError where the model has no frequency response."""
    system = compile_model(model, outputs)
    refuse_unfit(records, system, delays_of(model))
    return band or band_for(records, system)


def estimated(
    records: Sequence[Record], system: System, settings: FitSettings, delays: Mapping[str, str], band: tuple[float, float] | None
) -> Estimate:
    """The estimate, its ``fitted`` outputs those of a free simulation with what was found."""
    found = fit_frequency_domain(records, system, FrequencySettings(band, settings.use_priors), delays=delays)
    rows = [simulated(record, system, found.as_dict(), settings) for record in records]
    shown = tuple(blank if row is None else row for row, blank in zip(rows, found.fitted, strict=True))
    return replace(found, fitted=tuple(np.asarray(row) for row in shown))
