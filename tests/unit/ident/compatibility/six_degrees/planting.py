"""A fault of the check in the terms of the oracle flight."""

from __future__ import annotations

from ident.compatibility.kinematics import (
    ARM,
    BELOW,
    BIAS,
    BOOM,
    DELAY,
    DRIFT,
    LAG,
    PACKAGE,
    RIGHT,
    SCALE,
    SensorFault,
)
from tests.oracles.six_degrees import Faults

SIZES = {SCALE: 0.1, DELAY: 0.06, LAG: 0.06, ARM: 3.0, RIGHT: 3.0, BELOW: 3.0}


def size_of(fault: SensorFault) -> float:
    """A size that is felt: of a drift twice what is common in practice."""
    return SIZES.get(fault.kind, (2.0 if fault.kind == DRIFT else 1.0) * fault.plausible)


def planted(fault: SensorFault, size: float) -> Faults:
    """The same fault in the terms of the oracle."""
    name = fault.channel
    ahead, right, below = (size * (fault.kind == axis) for axis in (ARM, RIGHT, BELOW))
    if name == BOOM:
        wrong = Faults(vanes=dict.fromkeys(("alpha", "beta"), (ahead, right, below)))
    elif name in ("alpha", "beta"):
        wrong = Faults(vanes={name: (ahead, right, below)})
    else:
        wrong = Faults(
            accelerometers={
                each: (ahead, right, below)
                for each in (("ax", "ay", "az") if name == PACKAGE else (name,))
            }
        )
    others = {
        SCALE: Faults(scale={name: 1.0 + size}),
        DELAY: Faults(delay={name: size}),
        LAG: Faults(lag={name: size}),
        DRIFT: Faults(drift={name: size}),
        BIAS: Faults(bias={name: size}),
    }
    return others.get(fault.kind, wrong)
