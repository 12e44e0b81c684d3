"""The model of a diagnosis as its study folder keeps it: as declared, and with the effects
found.
"""

from __future__ import annotations

from scenarios.diagnosis.tracing import Tracing
from scenarios.kept import DIAGNOSE, KeptModel, KeptReading
from scenarios.preparation.plan import ATTITUDE, LIFT, SPEED

SPIKES = "sensor-spikes:"


def kept_diagnosis(tracing: Tracing) -> KeptModel | None:
    """The model that a diagnosis leaves; None where the loop did not say what it was fitted
    with.
    """
    d, plan, vehicle = tracing.diagnosis, tracing.plan, tracing.vehicle
    if d.trained_before is None or d.trained_after is None:
        return None
    inputs = {signal.name for signal in tracing.model.equations.inputs}
    reading = KeptReading(
        tracing.records[0].hold.value,
        plan.hold is not None,
        weight=SPEED not in inputs or LIFT in inputs,
        attitude=ATTITUDE in inputs,
        rate=plan.rate or 0.0,
        lowpass=plan.lowpass or 0.0,
        trusted=plan.trusted,
    )
    claimed = tuple(claim.name for claim in d.effects if claim.claimed)
    spiked = tuple(
        name.removeprefix(SPIKES)
        for name in claimed
        if name.startswith(SPIKES) and name.removeprefix(SPIKES) in inputs
    )
    return KeptModel(
        DIAGNOSE,
        vehicle.model,
        vehicle.identity if vehicle.text else None,
        vehicle.text,
        vehicle.own_file,
        reading,
        tracing.model.biases,
        d.trained_after,
        d.trained_before,
        tracing.inputs.effects[0] if tracing.inputs.effects else None,
        spiked,
        claimed=claimed,
    )
