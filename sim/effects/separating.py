"""What to fly to tell effects apart, where several effects share the advice."""

from __future__ import annotations

MANY_SIZES = "inputs of many sizes (a multisine, or steps of five sizes): on three levels these are one and the same function"
FASTER_MOTION = "faster motion (short doublets, or a sweep up to the inverse of the lag): a lag loses amplitude there, a delay does not"
STEADY_FLIGHT = "steady flight before and after the maneuver, and the airspeed recorded"
ANOTHER_FALL = "a fall that begins higher or faster: it meets the same density at another Mach number"
BEYOND_PRODUCTS = (
    "both signals moved far, together and one after the other: as long as a derivative grows evenly with a signal, all that a record shows is the "
    "product of two signals, whichever of the two derivatives it is"
)
