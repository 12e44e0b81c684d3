"""Low-order equivalent system of a measured record by the filter of NASA TM-101722 and its bank of
delays.

Choices that NASA TM-101722 made by hand follow rules here: R is estimated from the record, P0 is a
quarter of the starting values, Q is that of the simulation's record, and perturbations are about
the initial trim if there is one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ident.banks.delays import DelayBank, run_delay_bank
from ident.banks.engines import BATCHED, ENGINES, compare_with_filterpy
from ident.estimate import Estimate
from ident.filters.problem import proportional_priors
from ident.flying_qualities.levels import qualities
from ident.flying_qualities.modes import characteristics
from ident.statistics.noise_levels import noise_envelope
from ident.statistics.residuals import tests_of_records
from ident.whole_record.layout import FitSettings
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment import (
    IdentificationResult,
    record_fits,
    values_for_prediction,
)
from scenarios.identification.cautions import cautions_of
from scenarios.preparation.declared_model import model_of_file
from scenarios.studies.comparison import bank_content
from scenarios.studies.declaration import rows_of
from scenarios.studies.estimating import FIT_STEP
from sim.closed_loop.airframe import load_x29
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise, System
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Record
from sim.vehicles.factory import loes_filter_model, model_from_constants

# ---- The fourteen-state filter of NASA TM-101722 set up for a record

# Initial variances of the paper's Tables 1 and 2 for what starts near zero, as deviations. L_q
# starts at one but is known better than to a quarter (a tenth in the tables); nz_0's is not
# printed: [own].
ENGINEERING_STD = {
    "delta": 0.01,
    "L_delta": 0.025,
    "L_q": 0.1,
    "L_0": 0.01,
    "M_0": 0.1,
    "delta_0": 1.5,
    "nz_0": 0.5,
}
# Table 1, initial state estimate, with the sign of the pseudo-control turned; SI, per inch of
# stick. The delay is the bank's.
PAPER_START = {
    "L_alpha": -1.91,
    "M_alpha": -14.0,
    "L_delta": -1.30e-4,
    "M_delta": 0.377,
    "L_q": 1.01,
    "M_q": -3.68,
    "inv_tau": 7.92,
    "delay": 0.0,
}
SIMULATION_SHARE = 0.1  # share of the flight's noise sigmas: R / 100


def loes_filter_system(
    model: Model,
    record: Record,
    noise_std: Mapping[str, float],
    process_density: Mapping[str, float],
    engineering: Mapping[str, float] = ENGINEERING_STD,
) -> System:
    """Compile a low-order equivalent system for the filter and its bank.

    Parameters
    ----------
    model : from ``loes_model``, with starting values and the fixed delay.
    record : its first stick and nz are the starts of delta and nz_0; alpha and q are perturbations
        about trim.
    noise_std : R of alpha (rad), q (rad/s) and nz (g) as standard deviations; for alpha and q also
        P0.
    process_density : of the rates of q, alpha or delta, (unit/s)^2 s.
    engineering : initial standard deviations of unknowns that start near zero, such as delta.
    """
    filtered = loes_filter_model(model)
    values, valid = record.output_array(["nz"])
    start = {"nz_0": float(values[0, int(np.argmax(valid[0]))])} if valid.any() else {}
    parameters = proportional_priors(filtered.parameters.with_values(start), engineering)
    std = {"alpha": noise_std["alpha"], "q": noise_std["q"], "delta": engineering["delta"]}
    initial = filtered.initial.with_values({"delta": float(record["stick"].values[0])}).with_prior(
        std
    )
    noise = Noise({name: noise_std[name] for name in ("alpha", "q", "nz")}, dict(process_density))
    return compile_model(
        replace(filtered, parameters=parameters, initial=initial, noise=noise), online=True
    )


# ---- Identification of a measured record's low-order equivalent system by the paper's filter
# and its bank of delays

# (rad/s2)^2 s, what the rule finds on the simulation's record
DENSITY: Mapping[str, float] = MappingProxyType({"q": 1e-6})
DERIVED = ("natural_frequency", "damping_ratio", "delay")
# perturbations from trim; the zero of nz is the parameter nz_0
PERTURBED = ("alpha", "q", "stick")
QUIET_START_TIME = 0.5  # s at the record's beginning
_FEWEST_QUIET = 8
# noise sigmas: scatter of a channel at rest; level above which it is not at rest
_STILL, _OFF_TRIM = 3.0, 5.0


def identify_loes(
    record: Record, vehicle: VehicleFile, engine: str | None = None
) -> IdentificationResult:
    """Run the bank of delays with a refined delay over a record, from a vehicle file's starting
    values, by an engine of ``ENGINES``.

    Raises
    ------
    RecordError, ModelError : as for ``run_delay_bank``.
    """
    noise = noise_levels(record)
    offsets = trim_of(record, noise)
    about_trim = less(record, offsets)
    system = filter_system(about_trim, vehicle, noise)
    chosen = ENGINES[engine] if engine else BATCHED
    found = run_delay_bank(about_trim, system, engine=chosen)
    second = (
        compare_with_filterpy(about_trim, system, found.bank, found.delays)
        if chosen is BATCHED
        else None
    )
    trim = np.array([offsets.get(name, 0.0) for name in found.estimate.output_names])[:, None]
    estimate = replace(found.estimate, fitted=tuple(rows + trim for rows in found.estimate.fitted))
    tests = tests_of_records(estimate, [record])
    fixed = {
        item.name: (item.value, item.unit)
        for item in system.parameters
        if not item.free and item.name not in estimate.names
    }
    if "delay" in fixed:
        fixed["delay"] = (found.refined, "s")
    derived = derived_of(estimate, vehicle, weighted_delay(found))
    kept = bank_content(chosen.name, second)
    return IdentificationResult(
        record, vehicle, "ekf", estimate, rows_of(estimate), (), derived, fixed, tests, engine=kept
    )


def filter_system(record: Record, vehicle: VehicleFile, noise: Mapping[str, float]) -> System:
    """Return the fourteen-state filter of a vehicle file for a record about its trim, or for the
    beginning of one.
    """
    return loes_filter_system(
        model_from_constants("loes", vehicle.constants, vehicle.derivatives), record, noise, DENSITY
    )


def noise_levels(record: Record) -> dict[str, float]:
    """Return the standard deviation of the noise of alpha (rad), q (rad/s) and nz (g), read off the
    record.

    Never below a tenth of the flight's in the paper, which it used for its simulation: a record
    without noise still differs from a low-order model. A channel that is absent, or too short to
    tell, gets that too.
    """
    telemetry = load_x29("F").telemetry
    floor = {"alpha": telemetry.alpha_noise, "q": telemetry.q_noise, "nz": telemetry.nz_noise}
    out = {name: SIMULATION_SHARE * std for name, std in floor.items()}
    for name in out:
        if name in record.output_names:
            try:
                out[name] = max(out[name], noise_envelope(record.only([name]))[name])
            except RecordError:
                continue
    return out


def trim_of(record: Record, noise: Mapping[str, float]) -> dict[str, float]:
    """Return the levels of alpha, q and stick where the record begins at rest and off zero; empty
    if it begins in motion or about zero.

    At rest: for ``QUIET_START_TIME`` s the stick does not move at all and no output scatters by
    more than three noise deviations.
    """
    quiet = record.time <= record.time[0] + QUIET_START_TIME
    levels = {}
    for channel in record.channels:
        use = quiet & channel.valid
        values = channel.values[use]
        if values.size < _FEWEST_QUIET:
            return {}
        limit = noise.get(channel.name, 0.0)
        if float(values.std()) > _STILL * limit + 1e-9 * float(np.abs(values).max()):
            return {}
        if channel.name in PERTURBED and abs(float(values.mean())) > _OFF_TRIM * limit:
            levels[channel.name] = float(values.mean())
    return levels


def less(record: Record, offsets: Mapping[str, float]) -> Record:
    """Return the record with constants subtracted from its channels."""
    if not offsets:
        return record

    def moved(channel: Channel) -> Channel:
        return replace(
            channel,
            values=np.where(channel.valid, channel.values - offsets.get(channel.name, 0.0), 0.0),
        )

    return replace(
        record,
        inputs=tuple(moved(c) for c in record.inputs),
        outputs=tuple(moved(c) for c in record.outputs),
    )


def derived_of(
    estimate: Estimate, vehicle: VehicleFile, delay: tuple[float, float]
) -> dict[str, tuple[float, float]]:
    """Return the natural frequency (rad/s), damping ratio and delay (s) with standard deviations.

    ``delay`` stands in, with its deviation, where the estimate does not have it. Frequency and
    damping are left out where the short period does not oscillate or a number is not finite.
    """
    fixed = {} if "delay" in estimate.names else {"delay": delay[0]}
    with np.errstate(all="ignore"):
        found = qualities(
            estimate, vehicle.constants["airspeed"], vehicle.constants["gravity"], fixed
        )
    out = {
        each.name: (each.value, each.std)
        for each in found
        if each.name in DERIVED and np.isfinite([each.value, each.std]).all()
    }
    return {**out, "delay": delay} if fixed else out


def weighted_delay(found: DelayBank) -> tuple[float, float]:
    """Return the likelihood-weighted delay of a bank, s."""
    return mean_delay(found.delays, found.weights)


def mean_delay(delays: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Return the weighted mean and standard deviation of delays ``(B,)``, s.

    The standard deviation is at least that of one step of the grid.
    """
    mean = float(weights @ delays)
    return mean, float(np.sqrt(weights @ (delays - mean) ** 2 + np.diff(delays).mean() ** 2 / 12.0))


def identify_low_order(
    record: Record,
    vehicle: VehicleFile,
    held_out: Sequence[Record],
    engine: str | None,
    *,
    trusted: bool,
) -> IdentificationResult:
    """Return the estimate of the low-order system by its filter, and its prediction."""
    if vehicle.uncertainty:
        raise DeclarationError(
            "the filter of the low-order system takes constants as exact",
            where="[uncertainty]",
            remedy="use --method output-error, or leave the table out",
        )
    found = identify_loes(record, vehicle, engine)
    model, settings = model_of_file(vehicle), FitSettings(FIT_STEP)
    outputs = [
        signal.name for signal in model.equations.outputs if signal.name in record.output_names
    ]
    system = compile_model(model.with_biases(outputs), outputs)
    values = found.estimate.as_dict() | {name: value for name, (value, _) in found.fixed.items()}
    fits = record_fits([record], held_out, system, values, settings, trusted=trusted)
    modes = characteristics(compile_model(model), found.estimate)
    cautions = cautions_of(vehicle, found.estimate, found.rows)
    trained = values_for_prediction(system, values, settings)
    return replace(
        found,
        cautions=cautions,
        fits=fits,
        modes=modes,
        system=compile_model(model),
        trained=trained,
    )
