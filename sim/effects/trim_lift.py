"""The lift that carries the weight, which grows with the dynamic pressure like any other: what a change of airspeed adds to the ``lift`` port."""

from __future__ import annotations

from typing import Any

from sim.maths.constants import G0


def weight_lift(change: Any, vehicle: Any, airspeed_change: Any = 0.0, density_change: Any = 0.0) -> Any:
    """Increment of the port ``lift`` where the airspeed changes by ``change`` (m/s) and surfaces and attitude stay as in trim.

    About level flight nz gains qbar/qbar_0 - 1 and alpha_dot loses (g/V) (qbar/qbar_0 - 1), V the changed airspeed. On equations with
    a mass ``lift`` is a coefficient, m g0/S (1/qbar_0 - 1/qbar); on those with a dimensional lift it is that rate of alpha, 1/s, negative
    where the aircraft is faster. qbar_0 holds at the declared airspeed and density.

    Parameters
    ----------
    change : m/s, above what the ports hold already. vehicle : constants of the equations.
    airspeed_change, density_change : m/s and kg/m3, what the ports of these names hold before; their own lift is not counted here.
    """
    V = vehicle.airspeed + airspeed_change
    if hasattr(vehicle, "mass"):
        density = vehicle.air_density
        loading = 2.0 * vehicle.mass * G0 / (vehicle.wing_area * (density + density_change))
        # The share of qbar_0 drops out: m g0/S (1/qbar_before - 1/qbar_after).
        return loading * (1.0 / (V * V) - 1.0 / ((V + change) * (V + change)))
    return _excess(V, vehicle) - _excess(V + change, vehicle)


def _excess(V: Any, vehicle: Any) -> Any:
    """(g/V) (qbar/qbar_0 - 1), 1/s, at constant density."""
    return vehicle.gravity / V * (V * V / (vehicle.airspeed * vehicle.airspeed) - 1.0)
