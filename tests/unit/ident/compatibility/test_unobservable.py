"""Which faults are said to look alike."""

from __future__ import annotations

import numpy as np
import pytest

from ident.compatibility.kinematics import ARM, DELAY, LAG, SensorFault
from ident.compatibility.unobservable import unobservable_faults

ALPHA, LATE = SensorFault("alpha", LAG), SensorFault("alpha", DELAY)
VANE, LOAD = SensorFault("alpha", ARM), SensorFault("nz", ARM)
CHANCE = 5.0


def told(first: SensorFault, second: SensorFault, traces: np.ndarray, standing: str = "") -> str:
    """The sentences on two faults, whose traces at plausible sizes are columns in sigmas."""
    sentences = unobservable_faults(
        traces.T @ traces, (first, second), ("alpha", "nz"), CHANCE, {standing}
    )
    return "; ".join(line for line in sentences if "distinguished" in line)


def traces(gain: float, apart: float, sign: float = 1.0) -> np.ndarray:
    """Two traces of equal length, each of which the other one misses by ``apart`` of log
    likelihood.
    """
    sine = np.sqrt(apart / gain)
    length = np.sqrt(2.0 * gain)
    return length * np.array([[1.0, sign * np.sqrt(1.0 - sine**2)], [0.0, sine]])


@pytest.mark.parametrize(("gain", "apart", "alike"), [(100.0, 4.0, True), (1000.0, 40.0, False)])
def test_two_alike_traces_are_told_apart_by_what_the_false_one_loses(
    gain: float, apart: float, alike: bool
) -> None:
    columns = traces(gain, apart)
    # By least squares: what is left of the one after the best fit of the other.
    left = np.linalg.lstsq(columns[:, 1:], columns[:, 0], rcond=None)[1]
    assert 0.5 * float(left[0]) == pytest.approx(apart)
    assert bool(told(ALPHA, LATE, columns)) is alike


def test_effects_of_opposite_sign_look_alike_only_where_both_signs_are_possible() -> None:
    opposite = traces(100.0, 1.0, -1.0)
    assert "vane-offset and accelerometer-offset:nz" in told(VANE, LOAD, opposite)
    assert told(VANE, ALPHA, opposite) == ""


def test_a_fault_that_stands_was_compared_by_these_records() -> None:
    same = traces(100.0, 1.0)
    assert told(ALPHA, LATE, same) and told(ALPHA, LATE, same, ALPHA.name) == ""
