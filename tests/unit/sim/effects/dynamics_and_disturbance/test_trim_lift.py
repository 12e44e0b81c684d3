"""The lift that carries the weight, by the balance of forces at two speeds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sim.effects.disturbance.airspeed import weight_lift
from sim.maths import G0
from tests.bases import LOES_CONSTANTS, RIGID_VALUES

RIGID = SimpleNamespace(**RIGID_VALUES)
LOES = SimpleNamespace(**LOES_CONSTANTS)


@pytest.mark.parametrize(
    ("change", "before", "denser"), [(12.0, 0.0, 0.0), (-25.0, 0.0, 0.0), (-9.0, 15.0, 0.07)]
)
def test_on_the_rigid_aircraft_it_is_what_the_wings_carry_beyond_what_they_carried(
    change: float, before: float, denser: float
) -> None:
    weight = RIGID.mass * G0
    density, slow, fast = (
        RIGID.air_density + denser,
        RIGID.airspeed + before,
        RIGID.airspeed + before + change,
    )
    CL_slow = weight / (0.5 * density * slow**2 * RIGID.wing_area)
    # Carried at the old coefficient: more than the weight by the ratio of the pressures.
    surplus = 0.5 * density * fast**2 * RIGID.wing_area * CL_slow - weight
    added = weight_lift(change, RIGID, before, denser) * 0.5 * density * fast**2 * RIGID.wing_area
    assert added == pytest.approx(surplus, rel=1e-12)
    assert added / weight == pytest.approx((fast / slow) ** 2 - 1.0, rel=1e-12)


def test_on_the_low_order_equivalent_it_turns_the_path_and_loads_the_aircraft() -> None:
    change = -30.0
    rate = weight_lift(change, LOES)
    ratio, V = (1.0 + change / LOES.airspeed) ** 2, LOES.airspeed + change
    assert rate > 0.0, "a slower aircraft sinks, which raises the angle of attack"
    assert -V / LOES.gravity * rate == pytest.approx(ratio - 1.0, rel=1e-12)
    both = weight_lift(20.0, LOES) + weight_lift(-50.0, LOES, 20.0)
    assert both == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize("vehicle", [RIGID, LOES])
def test_without_a_change_it_is_nothing_and_it_takes_arrays_and_complex_steps(
    vehicle: SimpleNamespace,
) -> None:
    assert weight_lift(0.0, vehicle) == 0.0 and weight_lift(0.0, vehicle, 13.0) == 0.0
    changes = np.array([-5.0, 0.0, 5.0])
    np.testing.assert_array_equal(
        weight_lift(changes, vehicle), [weight_lift(change, vehicle) for change in changes.tolist()]
    )
    slope = weight_lift(complex(4.0, 1e-20), vehicle).imag / 1e-20
    assert slope == pytest.approx(
        (weight_lift(4.001, vehicle) - weight_lift(3.999, vehicle)) / 0.002, rel=1e-6
    )
