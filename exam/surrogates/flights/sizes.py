"""Effects whose size a surrogate flight may declare in the effect's own unit, instead of by the
error that it makes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from exam.surrogates.flights.drawing import SPEED, Drawn


@dataclass(frozen=True)
class Size:
    """What a declared size is: the effect's ``local`` parameter, its ``unit``, the largest that may
    be declared (``most``).

    ``either`` : the sign is drawn. ``speed_share`` : the size is the share of the airspeed lost
    over a record, the parameter m/s2.
    """

    local: str
    unit: str
    most: float
    either: bool = False
    speed_share: bool = False


SIZES: Mapping[str, Size] = {
    "gust-turbulence": Size("sigma", "m/s", 8.0),
    "vane-offset": Size("arm", "m", 40.0),
    "accelerometer-offset:nz": Size("arm", "m", 40.0, either=True),
    SPEED: Size("rate", "1", 0.5, speed_share=True),
}


def values_at(drawn: Drawn, name: str, size: float, sign: float = 1.0) -> dict[str, float]:
    """Local values of an effect of this ``size``; ``sign`` is used where the size may go either
    way.
    """
    what = SIZES[name]
    if what.speed_share:
        return {
            what.local: -size
            * drawn.declared.parameters["airspeed"].value
            / drawn.surrogate.flight.duration
        }
    return {what.local: sign * size if what.either else size}
