"""Built-in aircraft of the textbooks: modes, matrices and transfer functions of the linear models
against the printed ones.

A printed result follows from printed numbers: it can be no nearer than half a unit of the last
digit of each of them, carried through to the result, and of its own. That is the tolerance
throughout. What the textbooks neglect, the sets neglect (see their files).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from sim.maths import G0
from sim.vehicles.factory import SystemMatrices, linearise, model_from_constants
from sim.vehicles.library import Origin, VehicleData, read_parameter_set

FOOT = 0.3048
Result = Callable[[Mapping[str, float]], np.ndarray]


def half_unit(printed: str) -> float:
    """Half a unit of the last digit of a number, in its unit."""
    exponent = Decimal(printed.split()[0]).as_tuple().exponent
    assert isinstance(exponent, int)
    return 0.5 * 10.0**exponent


def rounding(data: VehicleData, result: Result) -> np.ndarray:
    """Largest change of a result when every number of a set moves by half a unit of its last
    printed digit; zeros are exact.
    """
    base, out = result(data.values), 0.0
    for number in data.numbers:
        if number.value != 0.0:
            step = number.value * half_unit(number.printed) / float(number.printed.split()[0])
            out = out + np.abs(result({**data.values, number.name: number.value + step}) - base)
    return np.asarray(out)


def check(name: str, result: Result, printed: Sequence[str]) -> None:
    """A result of a set is the printed one, to the digits of both."""
    data = read_parameter_set(name)
    found, tolerance = result(data.values), rounding(data, result)
    for value, carried, text in zip(found.tolist(), tolerance.tolist(), printed, strict=True):
        assert abs(value - float(text)) <= carried + half_unit(text), (text, value, carried)
        assert carried <= abs(value) / 6.0  # the digits do bind the result


def lateral(values: Mapping[str, float]) -> SystemMatrices:
    return linearise(model_from_constants("lateral", values, {}))


def longitudinal(values: Mapping[str, float]) -> SystemMatrices:
    """About level flight at the reference airspeed, its lift, moment and thrust recomputed by
    hand.
    """
    V = values["reference_airspeed"]
    force = 0.5 * values["air_density"] * V**2 * values["wing_area"]
    CL_V, CD_V, Cm_V = (values.get(name, 0.0) for name in ("CL_V", "CD_V", "Cm_V"))
    level = {**values, "CL_0": values["mass"] * G0 / force - CL_V, "Cm_0": -Cm_V}
    return linearise(
        model_from_constants("longitudinal", level, {}),
        about={"airspeed": V, "thrust": force * (values["CD_0"] + CD_V)},
    )


def modes(matrix: np.ndarray) -> np.ndarray:
    """Real roots by size, then real and imaginary part of each pair by size."""
    roots = sorted(np.linalg.eigvals(matrix).tolist(), key=abs)
    real = [root.real for root in roots if root.imag == 0.0]
    return np.array(
        real + [part for root in roots if root.imag > 0.0 for part in (root.real, root.imag)]
    )


def per_foot(system: SystemMatrices, values: Mapping[str, float]) -> np.ndarray:
    """Rows of A, B side by side with v (ft/s) in the place of beta, as the book has them; the zeros
    and ones by definition left out.
    """
    scale = np.diag([values["airspeed"] / FOOT, 1.0, 1.0, 1.0])
    both = np.hstack([scale @ system.A @ np.linalg.inv(scale), scale @ system.B])
    return np.array(
        [
            both[0, 0],
            both[0, 2],
            both[0, 3],
            both[0, 5],
            *both[1, [0, 1, 2, 4, 5]],
            *both[2, [0, 1, 2, 4, 5]],
        ]
    )


def bank_by_aileron(system: SystemMatrices) -> np.ndarray:
    """Gain and quadratic k (s^2 + a s + b) of the numerator, then the modes."""
    out = np.zeros((1, 4))
    out[0, 3] = 1.0
    numerator = np.poly(system.A - system.B[:, :1] @ out) - np.poly(system.A)
    return np.array([numerator[2], *(numerator[3:] / numerator[2]), *modes(system.A)])


# The tables' own derivatives: of Cx, Cz, Cm by u/V, alpha, q c/(2V), alpha_dot c/(2V), elevator,
# and CD of level flight.
TABLES = {
    "navion_longitudinal": (
        0.05,
        (-0.10, None, 0.0, 0.0, 0.0),
        (0.0, -4.49, 0.0, 0.0, -0.355),
        (0.0, -0.683, -9.96, -4.36, -0.923),
    ),
    "boeing747_longitudinal": (
        0.043,
        (-0.108, 0.2193, 0.0, 0.0, 0.0),
        (-0.106, -4.92, -5.921, 5.896, -0.3648),
        (0.1043, -1.023, -23.92, -6.314, -1.444),
    ),
}


def textbook(name: str) -> np.ndarray:
    """Rows V_dot/V, alpha_dot, q_dot and nz by u/V, alpha, q, theta, elevator from the tables, with
    alpha_dot in the coefficients.
    """
    data = read_parameter_set(name).values
    V, c = data["reference_airspeed"], data["chord"]
    force = 0.5 * data["air_density"] * V**2 * data["wing_area"]
    CL, k = data["mass"] * G0 / force, c / (2.0 * V)
    _, x, z, m = TABLES[name]
    Cx, Cz, Cm = (
        np.array([row[0], row[1] if row[1] is not None else CL - 0.33, row[2] * k, 0.0, row[4]])
        for row in (x, z, m)
    )
    level = np.array([-2.0 * CL, 0.0, 0.0, 0.0, 0.0])
    per_mass = force / (data["mass"] * V)
    alpha_dot = (per_mass * (Cz + level) + np.array([0.0, 0.0, 1.0, 0.0, 0.0])) / (
        1.0 - per_mass * z[3] * k
    )
    lift = -(Cz + level + z[3] * k * alpha_dot)
    pitching = force * c / data["pitch_inertia"] * (Cm + m[3] * k * alpha_dot)
    return np.array(
        [per_mass * (Cx - np.array([0.0, 0.0, 0.0, CL, 0.0])), alpha_dot, pitching, lift / CL]
    )


@pytest.mark.parametrize("name", TABLES)
def test_alpha_dot_is_eliminated_without_changing_the_linear_motion(name: str) -> None:
    def result(values: Mapping[str, float]) -> np.ndarray:
        system, V = longitudinal(values), values["reference_airspeed"]
        # States are airspeed, alpha, theta, q; inputs elevator, thrust; nz is the fifth output.
        rows = np.vstack([system.A[0] / V, system.A[1], system.A[3], system.C[4]])[
            :, [0, 1, 3, 2]
        ] * np.array([V, 1.0, 1.0, 1.0])
        return np.hstack(
            [
                rows,
                np.array([system.B[0, 0] / V, system.B[1, 0], system.B[3, 0], system.D[4, 0]])[
                    :, None
                ],
            ]
        )

    data = read_parameter_set(name)
    own = [number for number in data.numbers if number.origin is Origin.OWN]
    error = np.abs(result(data.values) - textbook(name))
    assert np.all(
        error
        <= rounding(replace(data, numbers=tuple(own)), lambda part: result({**data.values, **part}))
        + 1e-12
    )


def test_navion_lateral_modes_are_nelsons() -> None:
    # The example has N_beta = 4.488 where 0.071 of its own table gives 4.55: the spiral mode, a
    # small difference, moves by 7 percent.
    check(
        "navion_lateral",
        lambda values: modes(lateral(values).A),
        ("-0.00877", "-8.435", "-0.486", "2.335"),
    )


def test_navion_longitudinal_modes_are_nelsons() -> None:
    check(
        "navion_longitudinal",
        lambda values: modes(longitudinal(values).A),
        ("-0.0171", "0.213", "-2.51", "2.59"),
    )


def test_boeing_lateral_modes_are_etkins() -> None:
    check(
        "boeing747_lateral",
        lambda values: modes(lateral(values).A),
        ("-0.0072973", "-0.56248", "-0.033011", "0.94655"),
    )


def test_boeing_lateral_matrices_are_etkins() -> None:
    side, rolling = (
        ("-0.0558", "-774", "32.2", "5.642"),
        ("-0.003865", "-0.4342", "0.4136", "-0.1431", "0.1144"),
    )
    printed = (*side, *rolling, "0.001086", "-0.006112", "-0.1458", "0.003741", "-0.4859")
    check("boeing747_lateral", lambda values: per_foot(lateral(values), values), printed)


def test_boeing_longitudinal_modes_are_etkins() -> None:
    check(
        "boeing747_longitudinal",
        lambda values: modes(longitudinal(values).A),
        ("-0.003289", "0.06723", "-0.3719", "0.8875"),
    )


def test_dc8_bank_by_aileron_is_the_published_transfer_function() -> None:
    # -0.726 (s2 + 0.421 s + 0.889) / ((s - 0.013) (s + 1.121) (s2 + 0.22 s + 0.99))
    def result(values: Mapping[str, float]) -> np.ndarray:
        k, a, b, spiral, roll, real, imag = bank_by_aileron(lateral(values)).tolist()
        return np.array([k, a, b, spiral, roll, -2.0 * real, real**2 + imag**2])

    check("dc8_lateral", result, ("-0.726", "0.421", "0.889", "0.013", "-1.121", "0.22", "0.99"))
