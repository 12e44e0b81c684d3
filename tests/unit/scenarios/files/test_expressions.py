"""Expressions over columns: arithmetic as Python's, geometry as SciPy's rotations, and nothing that
could be executed.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scenarios.files.measured.expressions import evaluate, parse
from sim.errors import RecordError

COLUMNS = {
    "a": np.array([1.0, 2.0, np.nan]),
    "IMU[0].GyrX": np.array([3.0, -4.0, 5.0]),
    "AoA left": np.array([10.0, 20.0, 30.0]),
    "e1": np.ones(3),
}


def value(text: str, columns: dict[str, np.ndarray] | None = None) -> np.ndarray:
    return evaluate(parse(text, "here"), COLUMNS if columns is None else columns, "here")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.5*(a + IMU[0].GyrX)", [2.0, -1.0, np.nan]),
        ("-a**2 / 4 + 1e-3", [-0.249, -0.999, np.nan]),
        ("rad(`AoA left`)", np.radians([10.0, 20.0, 30.0])),
        ("pwm(`AoA left`, 10, 10)", [0.0, 1.0, 2.0]),
        ("table(a, [0, 2], [0, 20])", [10.0, 20.0, np.nan]),
        ("clip(IMU[0].GyrX, -1, 4)", [3.0, -1.0, 4.0]),
        ("e1*1e1 + pi*0", [10.0, 10.0, 10.0]),
        ("+a", [1.0, 2.0, np.nan]),
    ],
)
def test_values(text: str, expected: list[float]) -> None:
    np.testing.assert_allclose(value(text), expected, rtol=1e-14)


ANGLE = st.floats(-3.0, 3.0)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE, st.lists(st.floats(-80.0, 80.0), min_size=3, max_size=3))
def test_attitude_and_body_axes_are_those_of_rotations(
    psi: float, theta: float, phi: float, velocity: list[float]
) -> None:
    turn = Rotation.from_euler("ZYX", [psi, theta, phi])
    x, y, z, w = turn.as_quat()
    columns = {
        name: np.array([each])
        for name, each in zip(
            ("w", "x", "y", "z", "n", "e", "d"), (w, x, y, z, *velocity), strict=True
        )
    }
    for name, angle in (("roll", phi), ("pitch", theta), ("yaw", psi)):
        assert np.angle(
            np.exp(1j * (value(f"{name}(w, x, y, z)", columns)[0] - angle))
        ) == pytest.approx(0.0, abs=1e-6)
    columns |= {"phi": np.array([phi]), "theta": np.array([theta]), "psi": np.array([psi])}
    body = [value(f"body_{axis}(n, e, d, phi, theta, psi)", columns)[0] for axis in "uvw"]
    np.testing.assert_allclose(body, turn.inv().apply(velocity), atol=1e-9)


def test_the_standard_atmosphere() -> None:
    columns = {"p": np.array([101325.0, 70108.5, 22632.06, 5474.9])}
    np.testing.assert_allclose(
        value("height_of_pressure(p)", columns), [0.0, 3000.0, 11000.0, 20000.0], atol=2.0
    )
    columns = {
        "v": np.array([100.0, 100.0]),
        "h": np.array([0.0, 6096.0]),
        "T": np.array([288.15, 248.5]),
    }
    np.testing.assert_allclose(value("tas_of_ias(v, h, T)", columns), [100.0, 137.0], rtol=2e-3)
    np.testing.assert_allclose(value("tas_of_cas(v, h, T)", columns), [100.0, 135.5], rtol=5e-3)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "(lambda: 1)()", "[x for x in (1,)]", "a if a else 1", "a and 1", "a < 1", "'text'",  # noqa: E501
        "f'{a}'", "open(a)", "1e999", "sin(a, out=a)", "a :=", "", "a" * 501, "a @ a", "a // 2", "~a",  # noqa: E501
        "{a}", "print(a)", "a; a", "a\na", "1_0j",
    ],
)  # fmt: skip
def test_nothing_but_arithmetic(text: str) -> None:
    with pytest.raises(RecordError) as caught:
        found = parse(text, "map.toml, channel q")
        evaluate(
            found,
            {name: COLUMNS[name] for name in found.columns if name in COLUMNS} or COLUMNS,
            "map.toml, channel q",
        )
    assert "\n" not in str(caught.value) and str(caught.value).startswith("map.toml, channel q")


@pytest.mark.parametrize(
    "text", ["sin(a, a, a)", "table(a, [1, 2], [1])", "table(a, a, a)", "roll(a)"]
)
def test_wrong_arguments_are_reported(text: str) -> None:
    with pytest.raises(RecordError, match=r"cannot be computed|needs (one value|4 values), not"):
        value(text, {"a": np.ones(4)})


@pytest.mark.parametrize("text", ["a.real", "True", "a[0]", "sin", "sin.__class__"])
def test_a_dotted_word_is_the_name_of_a_column_and_nothing_else(text: str) -> None:
    assert parse(text, "here").columns == (text,)
