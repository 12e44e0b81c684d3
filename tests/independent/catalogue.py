"""What may be put into a flight: each fault with the sizes it comes in, and the answers that are
right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.independent import injected, recorder
from tests.independent.injected import Fault
from tests.independent.recorder import SheetFault
from tests.independent.recording import USUAL

Pair = tuple[Fault, SheetFault]
Make = Callable[[float, np.random.Generator], Pair]


@dataclass(frozen=True)
class Planted:
    """A kind of fault.

    ``sizes`` are the smallest and the largest of the kind in ``unit``. ``right`` are effect names
    that say it; ``twins`` are names that the same record also bears exactly or nearly so, right
    only where one of ``right`` stands among their alternatives. ``channels`` are the words by which
    a warning can name it: the columns that it spoils, or others where it spoils none.
    ``either_sign`` lets a drawn size be negative.
    """

    name: str
    unit: str
    sizes: tuple[float, float]
    make: Make
    right: frozenset[str]
    twins: frozenset[str]
    channels: tuple[str, ...]
    either_sign: bool = False
    rough_air: bool = False

    def drawn(self, rng: np.random.Generator) -> float:
        """A size between the smallest and the largest, of either sign where that makes sense."""
        size = float(rng.uniform(*self.sizes))
        return -size if self.either_sign and rng.random() < 0.5 else size


def _on_signals(
    name: str,
    sizes: str,
    fault: Callable[[float], Fault],
    spoils: str,
    right: str = "",
    twins: str = "",
    either: bool = False,
    rough: bool = False,
) -> Planted:
    """A fault of the true signals. ``sizes`` is smallest, largest and unit; names in one string are
    separated by blanks.
    """
    return _planted(
        name,
        sizes,
        lambda size, rng: (fault(size), recorder.untouched),
        spoils,
        right,
        twins,
        either,
        rough,
    )


def _in_the_file(
    name: str,
    sizes: str,
    fault: Callable[[float, np.random.Generator], SheetFault],
    spoils: str,
    right: str = "",
    twins: str = "",
) -> Planted:
    """A fault of the written columns."""
    return _planted(
        name, sizes, lambda size, rng: (injected.nothing, fault(size, rng)), spoils, right, twins
    )


def _planted(
    name: str,
    sizes: str,
    make: Make,
    spoils: str,
    right: str,
    twins: str,
    either: bool = False,
    rough: bool = False,
) -> Planted:
    low, high, unit = sizes.split(" ", 2) if sizes else ("0", "0", "")
    return Planted(
        name,
        unit,
        (float(low), float(high)),
        make,
        frozenset(right.split()),
        frozenset(twins.split()),
        tuple(spoils.split()),
        either,
        rough,
    )


def _q_scale(size: float) -> Fault:
    return injected.wrong_scale("q", 1.0 + size)


def _curved(size: float) -> Fault:
    """Curvature such that at 4 degrees from trim the vane is ``size`` of them off."""
    return injected.curved_calibration("alpha", size / np.radians(4.0))


def _stepped(name: str, share: float) -> Callable[[float], Fault]:
    return lambda size: injected.zero_steps(name, share, size * USUAL[name])


def _clock(size: float) -> Fault:
    return injected.clock_fast(1.0 + size)


def _calm(size: float) -> Fault:
    return injected.nothing


def _always(fault: SheetFault) -> Callable[[float, np.random.Generator], SheetFault]:
    return lambda size, rng: fault


# At constant speed a clock k times fast is the angle of attack times 1/k: k alpha_dot = q - (g/V)
# nz, and the derivatives take up the rest.
CLOCK_TWIN = "sensor-scale:alpha"
ALPHA_LATE, Q_LATE, NZ_LATE = (
    f"sensor-delay:{name} sensor-lag:{name}" for name in ("alpha", "q", "nz")
)
NOTHING = _on_signals("nothing", "", _calm, "")
LATE_ALPHA = _on_signals(
    "late-alpha",
    "0.03 0.12 s",
    partial(injected.late_sensor, "alpha"),
    "alpha",
    ALPHA_LATE,
    "vane-offset",
)
ON_SIGNALS = (
    NOTHING,
    LATE_ALPHA,
    _on_signals(
        "lagging-alpha",
        "0.05 0.15 s",
        partial(injected.lagging_sensor, "alpha"),
        "alpha",
        ALPHA_LATE,
        "vane-offset",
    ),
    _on_signals("late-q", "0.03 0.10 s", partial(injected.late_sensor, "q"), "q", Q_LATE),
    _on_signals(
        "late-nz",
        "0.03 0.10 s",
        partial(injected.late_sensor, "nz"),
        "nz",
        NZ_LATE,
        "accelerometer-offset:nz",
    ),
    _on_signals(
        "vane-ahead",
        "2 15 m",
        injected.vane_ahead,
        "alpha",
        "vane-offset",
        f"{ALPHA_LATE} accelerometer-offset:nz",
    ),
    _on_signals("q-scale", "0.05 0.20 part", _q_scale, "q", "sensor-scale:q", either=True),
    _on_signals(
        "late-surface",
        "0.04 0.10 s",
        injected.surface_follows_late,
        "elevator",
        "input-delay",
        "actuator-lag actuator-second-order",
    ),
    _on_signals(
        "accelerometer-ahead",
        "3 12 m",
        injected.accelerometer_ahead,
        "nz",
        "accelerometer-offset:nz",
        f"vane-offset {NZ_LATE}",
        either=True,
    ),
    _on_signals("rough-air", "", _calm, "alpha nz", "gust-turbulence", rough=True),
    _on_signals(
        "input-recorded-late",
        "0.04 0.10 s",
        injected.surface_recorded_late,
        "elevator",
        "input-recorded-late",
    ),
    _on_signals(
        "q-feels-nz",
        "0.01 0.03 rad/s per g",
        injected.gyro_feels_load,
        "q",
        "sensor-coupling:q",
        "sensor-scale:nz",
        either=True,
    ),
    _on_signals(
        "curved-vane",
        "0.15 0.40 part at 4 deg",
        _curved,
        "alpha",
        "sensor-curve:alpha",
        either=True,
    ),
    _on_signals(
        "alpha-zero-step", "3 10 sigma", _stepped("alpha", 0.55), "alpha", "sensor-step:alpha"
    ),
    _on_signals("q-zero-step", "3 10 sigma", _stepped("q", 0.4), "q", "sensor-step:q"),
    _on_signals(
        "nz-drift",
        "0.001 0.004 g/s",
        partial(injected.drifting, "nz"),
        "nz",
        "sensor-drift:nz",
        either=True,
    ),
    _on_signals(
        "alpha-held",
        "0.08 0.20 s",
        partial(injected.held, "alpha"),
        "alpha",
        "sensor-hold:alpha",
        "sensor-delay:alpha",
    ),
    _on_signals("clock-fast", "0.05 0.15 part", _clock, "time_base clock", "time-base", CLOCK_TWIN),
)
IN_THE_FILE = (
    _in_the_file(
        "q-held-lower",
        "3 8 rows",
        lambda size, rng: recorder.held_lower("q", round(size)),
        "q",
        "sensor-hold:q",
        "sensor-delay:q",
    ),
    _in_the_file(
        "alpha-stuck", "1 3 s", lambda size, rng: recorder.stuck("alpha", 4.0, size), "alpha"
    ),
    _in_the_file(
        "nz-clipped", "0.10 0.25 part", lambda size, rng: recorder.clipped("nz", size), "nz"
    ),
    _in_the_file(
        "alpha-coarse",
        "3 10 sigma",
        lambda size, rng: recorder.coarse("alpha", size * USUAL["alpha"]),
        "alpha",
    ),
    _in_the_file(
        "q-zero-runs", "0.5 1.5 s", lambda size, rng: recorder.zero_runs("q", 3.0, size), "q"
    ),
    _in_the_file(
        "rows-missing",
        "0.5 2 s",
        lambda size, rng: recorder.rows_missing(3.5, size),
        "rows gap gaps missing",
    ),
    _in_the_file(
        "alpha-step-in-file",
        "4 12 sigma",
        lambda size, rng: recorder.zero_step("alpha", 11.0, size * USUAL["alpha"]),
        "alpha",
        "sensor-step:alpha",
    ),
    _in_the_file(
        "nz-noise-burst",
        "4 10 sigma",
        lambda size, rng: recorder.noise_burst("nz", 8.0, 5.0, size * USUAL["nz"], rng),
        "nz",
    ),
    _in_the_file(
        "q-hum", "1 4 sigma", lambda size, rng: recorder.hum("q", 13.0, size * USUAL["q"]), "q"
    ),
    *(
        _in_the_file(f"{name}-degrees", "", _always(recorder.in_degrees(name)), name)
        for name in ("alpha", "q", "elevator")
    ),
    _in_the_file("nz-metric", "", _always(recorder.in_metres_per_second_squared), "nz"),
    *(
        _in_the_file(f"{name}-turned", "", _always(recorder.sign_turned(name)), name)
        for name in ("alpha", "q", "nz", "elevator")
    ),
    _in_the_file("alpha-q-exchanged", "", _always(recorder.exchanged("alpha", "q")), "alpha q"),
    _in_the_file(
        "alpha-elevator-exchanged",
        "",
        _always(recorder.exchanged("alpha", "elevator")),
        "alpha elevator",
    ),
    _in_the_file(
        "time-base-wrong",
        "0.10 1.0 part",
        lambda size, rng: recorder.time_base(1.0 + size),
        "time_base clock",
        "time-base",
        CLOCK_TWIN,
    ),
)
FAULTS = {one.name: one for one in (*ON_SIGNALS, *IN_THE_FILE)}
FIRST = (
    "nothing",
    "late-alpha",
    "vane-ahead",
    "q-scale",
    "late-surface",
    "accelerometer-ahead",
    "rough-air",
)
"""The faults of the acceptance flights."""
