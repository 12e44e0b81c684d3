"""The fourteen-state filter of NASA TM-101722 set up for a record: R, P0 and Q by the paper's rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.filters.problem import proportional_priors
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise, System
from sim.errors import RecordError
from sim.record import Channel, Record
from sim.vehicles.factory import loes_filter_model

# Initial variances of the paper's Tables 1 and 2 for what starts near zero, as deviations. L_q starts at one but is known
# better than to a quarter (a tenth in the tables); nz_0's is not printed: [own].
ENGINEERING_STD = {"delta": 0.01, "L_delta": 0.025, "L_q": 0.1, "L_0": 0.01, "M_0": 0.1, "delta_0": 1.5, "nz_0": 0.5}
# Table 1, initial state estimate, with the sign of the pseudo-control turned; SI, per inch of stick. The delay is the bank's.
PAPER_START = {"L_alpha": -1.91, "M_alpha": -14.0, "L_delta": -1.30e-4, "M_delta": 0.377, "L_q": 1.01, "M_q": -3.68, "inv_tau": 7.92, "delay": 0.0}
SIMULATION_SHARE = 0.1  # of the flight's noise deviations: R / 100


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
    model : from ``loes_model``; its values are the start (of alpha and q as well), its delay the held one.
    record : gives the start of delta (the first stick) and of nz_0 (the first nz); alpha and q are perturbations about trim.
    noise_std : R of alpha (rad), q (rad/s) and nz (g) as deviations; those of alpha and q are their P0 too.
    process_density : of the rates of q, alpha or delta, (unit/s)^2 s.
    engineering : deviations of what starts near zero, the state delta among them.
    """
    filtered = loes_filter_model(model)
    values, valid = record.output_array(["nz"])
    start = {"nz_0": float(values[0, int(np.argmax(valid[0]))])} if valid.any() else {}
    parameters = proportional_priors(filtered.parameters.with_values(start), engineering)
    std = {"alpha": noise_std["alpha"], "q": noise_std["q"], "delta": engineering["delta"]}
    initial = filtered.initial.with_values({"delta": float(record["stick"].values[0])}).with_prior(std)
    noise = Noise({name: noise_std[name] for name in ("alpha", "q", "nz")}, dict(process_density))
    return compile_model(replace(filtered, parameters=parameters, initial=initial, noise=noise), online=True)


def about_trim(record: Record, until: float) -> Record:
    """The record with alpha, q and stick as perturbations: less their means up to the time ``until`` (s), before the maneuver.

    Raises RecordError when a channel has no sample by then.
    """
    quiet = record.time <= until

    def moved(channel: Channel) -> Channel:
        use = quiet & channel.valid
        if channel.name not in ("alpha", "q", "stick"):
            return channel
        if not use.any():
            raise RecordError(f"no sample up to {until:g} s", where=f"{record.name}, channel {channel.name}", remedy="give a later time")
        return replace(channel, values=np.where(channel.valid, channel.values - channel.values[use].mean(), 0.0))

    return replace(record, inputs=tuple(moved(c) for c in record.inputs), outputs=tuple(moved(c) for c in record.outputs))
