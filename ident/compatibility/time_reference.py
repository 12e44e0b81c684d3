"""Against what channels are late: kinematics see differences of times only, so that one channel stands for the time of all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ident.compatibility.faults import DELAY, LAG, SensorFault
from ident.compatibility.instruments import instrumented
from ident.compatibility.signals import Signals

_TIMED = ("alpha", "q", "nz", "theta")  # what the relations tie within a fraction of a second; speed changes too slowly to be a clock


def clocks(signals: Sequence[Signals]) -> tuple[str, ...]:
    """Channels of which one at least has to be on time.

    Where no control is recorded the load is none of them: a gust moves it before the path, and alpha and q then seem late by as much.
    """
    return tuple(name for name in _TIMED if name in signals[0].channels and (name != "nz" or instrumented(signals)))


def late_channels(faults: Iterable[SensorFault]) -> set[str]:
    """Channels that these faults make late."""
    return {fault.channel for fault in faults if fault.kind in (DELAY, LAG) and fault.channel in _TIMED}


def leaves_a_reference(faults: Sequence[SensorFault], timed: Sequence[str]) -> bool:
    """Whether one of the clocks ``timed`` is on time beside these faults: with all of them late, only differences of times are there to be fitted.

    Nothing is recorded before it happens, so that what remains is the channel that is least late.
    """
    return not timed or not set(timed) <= late_channels(faults)


def reference_sentence(faults: Sequence[SensorFault], timed: Sequence[str]) -> str:
    """Which of the clocks ``timed`` the times of these faults count from; nothing where no channel is late."""
    late = late_channels(faults)
    on_time = [name for name in timed if name not in late]
    if not late or not on_time:
        return ""
    if len(on_time) == 1:
        first = f"times count from {on_time[0]}, the channel that is least late"
    else:
        first = f"times count from {', '.join(on_time[:-1])} and {on_time[-1]}, which agree"
    return f"{first}: what all channels are late by against the inputs, kinematics cannot see"
