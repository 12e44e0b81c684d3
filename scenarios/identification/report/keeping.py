"""The model of an identification as its study folder keeps it."""

from __future__ import annotations

import numpy as np

from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.gravity import PATH
from scenarios.identification.methods import uses_attitude
from scenarios.identification.result import Identification
from scenarios.kept.kept_model import IDENTIFY, KeptModel, KeptReading
from scenarios.preparation.plan import LIFT, SPEED, Plan


def kept_identification(found: Identification, plan: Plan) -> KeptModel | None:
    """The model that an identification leaves; None where its numbers are not finite, and it predicts nothing."""
    trained, vehicle, first = found.trained, found.vehicle, found.record
    if trained is None or not np.all(np.isfinite([*trained.shared.values(), *trained.own[0].values()])):
        return None
    by_own_filter = vehicle.model == "loes" and found.method == "ekf"
    measured = set(first.input_names)
    reading = KeptReading(
        first.hold.value,
        plan.hold is not None,
        weight=SPEED not in measured or LIFT in measured,
        flow=not by_own_filter and found.method != FREQUENCY,
        attitude=uses_attitude(vehicle, found.method),
        rate=plan.rate or 0.0,
        lowpass=plan.lowpass or 0.0,
        trusted=plan.trusted,
    )
    identity = vehicle.identity if vehicle.text else None
    biases = tuple(name.removeprefix("bias_") for name in trained.own[0])
    return KeptModel(IDENTIFY, vehicle.model, identity, vehicle.text, vehicle.own_file, reading, biases, trained, weighed=PATH in trained.shared)
