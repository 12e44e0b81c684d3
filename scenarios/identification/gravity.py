"""A recorded pitch attitude in the identification of a rigid aircraft: the weight along the flight path changes the speed, and the loads with it.

The equations are those of the effect phugoid with theta an input: u_dot = -g (theta - alpha), the flight path at the record's begin the one further
unknown of each record. Whether they act is asked of the records: in a tunnel, on a rig or in a simulation at constant speed they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenarios.preparation.interpreting import BETTER, better_by
from scenarios.preparation.plan import ATTITUDE
from sim.declaration.model import Model
from sim.effects.disturbance.phugoid import Phugoid
from sim.record import Record

PATH = "phugoid.attitude"


def with_weight(model: Model) -> Model:
    """The model with the component of the weight along the flight path; its begin is free, what a drag polar says stays at usual values."""
    wider = model.with_effects(Phugoid(attitude_recorded=True))
    held = [name for name in wider.parameters.names if name.startswith("phugoid.") and name != PATH]
    return wider.with_parameters(wider.parameters.hold(held))


def weighed(model: Model, records: Sequence[Record], outputs: Sequence[str]) -> tuple[Model, str]:
    """The model with or without the weight along the flight path, as the records say, and a sentence; empty where no attitude is recorded."""
    if ATTITUDE not in {signal.name for signal in model.equations.inputs}:
        return model, ""
    wider = with_weight(model)
    found = better_by((model, list(records)), (wider, list(records)), outputs, local=[PATH])
    gain = found.gain
    if found.why_open:
        return (
            model,
            f"the pitch attitude is measured and not used: fits with and without the weight along the flight path decide nothing ({found.why_open})",
        )
    if gain < BETTER:
        return (
            model,
            f"the pitch attitude is measured and not used: the weight along the flight path explains no more (twice the log likelihood {gain:.1f})",
        )
    return (
        wider,
        f"the pitch attitude is measured: the weight along the flight path changes speed and loads (twice the log likelihood {gain:.1f} better)",
    )


def without_theta(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record]]:
    """The model and records less an attitude among the inputs that nothing uses."""
    inputs = tuple(signal for signal in model.equations.inputs if signal.name != ATTITUDE)
    bare = [replace(record, inputs=tuple(channel for channel in record.inputs if channel.name != ATTITUDE)) for record in records]
    return replace(model, equations=replace(model.equations, inputs=inputs)), bare  # type: ignore[type-var]
