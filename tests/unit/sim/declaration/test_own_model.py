"""A user's own model: the equations that it makes, the ports and biases that it has, and the
numbers of a built-in one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Biased, Model
from sim.declaration.user_model import rate_unit
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.errors import ModelError
from tests.bases import RIGID_VALUES, rigid_model
from tests.own_models import own_rigid, roll
from tests.rigid_problem import FREE, rigid_record


def test_roll_declares_what_it_was_given() -> None:
    model = roll(initial={"phi": 0.2}, bounds={"L_p": (-10.0, 0.0)})
    assert [s.unit for s in model.equations.states] == ["rad/s", "rad"]
    assert model.parameters.names == (
        "airspeed",
        "L_p",
        "L_da",
    ) and model.parameters.free_names == ("L_p", "L_da")
    assert model.parameters["L_p"].bounds == (-10.0, 0.0) and model.initial.values().tolist() == [
        0.0,
        0.2,
    ]
    assert [(port.name, port.unit) for port in model.equations.ports] == [
        ("p_rate", "rad/s2"),
        ("phi_rate", "rad/s"),
    ]


def test_rates_are_those_of_the_matrix() -> None:
    system = compile_model(roll())
    for x in np.random.default_rng(1).standard_normal((5, 3)):
        rates = system.f(0.0, x[:2].tolist(), x[2:].tolist(), [60.0, -2.0, 8.0])
        assert np.allclose(
            rates,
            np.array([[-2.0, 0.0], [1.0, 0.0]]) @ x[:2] + np.array([8.0, 0.0]) * x[2],
            rtol=1e-15,
            atol=0.0,
        )


def test_a_port_is_added_to_the_rate_of_its_state() -> None:
    class Push:
        name, station, regularity, explanation = (
            "push",
            UnmeasuredInput().station,
            UnmeasuredInput().regularity,
            "",
        )
        parameters, states, aliases, needs = (), (), (), ("phi_rate",)
        absent: Mapping[str, float] = MappingProxyType({})

        def increments(self, s: Any, vehicle: Any, p: Any) -> dict[str, float]:
            return {"phi_rate": 0.25}

        def derivatives(self, s: Any, vehicle: Any, p: Any) -> tuple[()]:
            return ()

    calm, pushed = (
        compile_model(each).f(0.0, [0.1, 0.2], [0.05], [60.0, -2.0, 8.0])
        for each in (roll(), roll().with_effects(Push()))
    )
    assert (np.array(pushed) - calm).tolist() == pytest.approx([0.0, 0.25], abs=1e-15)


def test_ports_of_its_own_are_signals_of_its_functions() -> None:
    model = roll(
        ports={"gust": "rad"},
        rates=lambda s, p: {"p": p.L_p * (s.p + s.gust) + p.L_da * s.aileron, "phi": s.p},
    )
    assert [port.name for port in model.equations.ports] == ["gust"]
    s, p = (
        SimpleNamespace(p=1.0, phi=0.0, aileron=0.0, gust=0.5),
        SimpleNamespace(L_p=-2.0, L_da=8.0),
    )
    assert list(model.equations.derivatives(s, p)) == [-3.0, 1.0]
    assert roll(ports={}).equations.ports == ()


def test_arrays_and_complex_numbers_pass_through() -> None:
    system, rng = compile_model(own_rigid(RIGID_VALUES)), np.random.default_rng(2)
    x, u, p = (
        rng.standard_normal((2, 3, 5)),
        rng.standard_normal((1, 3, 5)),
        system.parameters.values(),
    )
    together = np.array(system.f(0.0, list(x), list(u), p.tolist()))
    alone = [
        system.f(0.0, x[:, i, j].tolist(), u[:, i, j].tolist(), p.tolist())
        for i in range(3)
        for j in range(5)
    ]
    assert np.array_equal(together.reshape(2, 15).T, alone)
    stepped = system.f(0.0, [complex(0.1, 1e-30), 0.2], [0.0], p.tolist())
    difference = (
        np.array(system.f(0.0, [0.1 + 1e-6, 0.2], [0.0], p.tolist()))
        - system.f(0.0, [0.1 - 1e-6, 0.2], [0.0], p.tolist())
    ) / 2e-6
    assert np.imag(stepped) / 1e-30 == pytest.approx(difference, rel=1e-8)


def test_rigid_of_its_own_is_fitted_as_the_built_in_one() -> None:
    record = rigid_record(np.random.default_rng(3), duration=4.0)
    wrong = {**RIGID_VALUES, **{name: 1.2 * RIGID_VALUES[name] for name in FREE}}

    def fitted(model: Model) -> np.ndarray:
        free = model.with_parameters(model.parameters.only_free(FREE)).with_biases(
            ["alpha", "q", "nz"]
        )
        found = fit_output_error([record], compile_model(free), FitSettings(0.02))
        return np.array([found.value(name) for name in FREE])

    assert fitted(own_rigid(wrong)) == pytest.approx(fitted(rigid_model(wrong)), rel=1e-9)


def test_what_cannot_be_formed_is_no_number_and_no_crash() -> None:
    model = roll(
        initial={"p": 1.0}, rates=lambda s, p: {"p": p.L_p / s.p + p.L_da * s.aileron, "phi": s.p}
    )
    rates = compile_model(model).f(0.0, [0.0, 0.0], [0.0], [60.0, -2.0, 8.0])
    assert all(math.isnan(rate) for rate in rates)


def test_an_error_in_a_later_call_names_file_and_line() -> None:
    def rates(s: Any, p: Any) -> dict[str, Any]:
        found = {"p": p.L_p * s.p + p.L_da * s.aileron, "phi": s.p}
        return found if np.ndim(s.p) < 2 else undefined  # type: ignore[name-defined]  # noqa: F821

    system, high = compile_model(roll(rates=rates)), np.zeros((2, 2))
    with pytest.raises(
        ModelError, match=r"model roll, rates \(.*test_own_model\.py, line \d+\): NameError"
    ):
        system.f(0.0, [high, high], [high], [60.0, -2.0, 8.0])


@pytest.mark.parametrize(
    ("unit", "rate"),
    [
        ("rad", "rad/s"),
        ("m/s", "m/s2"),
        ("m/s2", "m/s3"),
        ("1", "1/s"),
        ("1/s", "1/s2"),
        ("kg", "kg/s"),
        ("N m", "N m/s"),
    ],
)
def test_units_of_rates(unit: str, rate: str) -> None:
    assert rate_unit(unit) == rate


def declared(A: np.ndarray, C: np.ndarray) -> Model:
    """A linear model with these matrices, whose only parameter is a common factor of the rates."""
    names, read = [f"x{i}" for i in range(len(A))], [f"y{i}" for i in range(len(C))]

    def sums(rows: np.ndarray, s: Any, factor: Any) -> list[Any]:
        return [
            factor * sum(a * getattr(s, name) for a, name in zip(row, names, strict=True))
            for row in rows.tolist()
        ]

    return own_model(
        name="linear",
        states=dict.fromkeys(names, "1"),
        inputs={},
        outputs=dict.fromkeys(read, "1"),
        parameters={"factor": (1.0, "1")},
        rates=lambda s, p: dict(zip(names, sums(A, s, p.factor), strict=True)),
        readings=lambda s, p: dict(zip(read, sums(C, s, 1.0), strict=True)),
    )


def seen(A: np.ndarray, C: np.ndarray, biases: list[int]) -> int:
    """How many directions of initial states and biases a record of four seconds shows: the rank of
    its samples.
    """
    constant = np.eye(len(C))[:, biases]
    return int(
        np.linalg.matrix_rank(
            np.vstack([np.hstack([C @ expm(A * t), constant]) for t in np.linspace(0.0, 4.0, 41)]),
            tol=1e-8,
        )
    )


@pytest.mark.parametrize(
    ("A", "C", "told"),
    [
        ([[-2.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], (0,)),  # the angle of a rate gyro
        ([[-2.0, 0.5], [1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], (0, 1)),  # an angle that acts back
        # two sensors of one angle: one tells where the other is
        ([[-2.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]], (0,)),
        ([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], ()),
        ([[0.0, 1.0], [-4.0, -0.2]], [[1.0, 0.0], [-4.0, -0.2]], (0, 1)),
    ],
)
def test_biases_that_no_record_tells_are_left_out(
    A: list[list[float]], C: list[list[float]], told: tuple[int, ...]
) -> None:
    a, c = np.array(A), np.array(C)
    equations = declared(a, c).equations
    assert isinstance(equations, Biased) and equations.biased_outputs == tuple(
        f"y{i}" for i in told
    )
    kept = list(told)
    assert seen(a, c, kept) == seen(a, c, []) + len(kept)
    assert all(
        seen(a, c, sorted([*kept, i])) == seen(a, c, kept) for i in range(len(c)) if i not in told
    )


def test_a_model_says_which_outputs_have_biases() -> None:
    assert (
        roll(biases=["phi"]).equations.biased_outputs == ("phi",)  # type: ignore[attr-defined]
        and roll(biases=()).equations.biased_outputs == ()  # type: ignore[attr-defined]
    )
