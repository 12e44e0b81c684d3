"""Arguments of a user's functions: they cannot be changed in place, and the time may be used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from ident.bilinear_table import system_tables
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.declaration.user_arguments import WatchedTime
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.errors import ModelError
from sim.maths import where
from tests.own_models import roll

Functions = Callable[[Any, Any], Mapping[str, Any]]


def spring(
    rates: Functions | None = None, readings: Functions | None = None, flow: Functions | None = None
) -> Model:
    """A mass on a spring with a stiffness of 4 1/s2."""
    return own_model(
        name="spring",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m", "v": "m/s"},
        parameters={"k": (4.0, "1/s2"), "c": (0.5, "1/s")},
        rates=rates or (lambda s, p: {"x": s.v, "v": s.force - p.c * s.v - p.k * s.x}),
        readings=readings or (lambda s, p: {"x": s.x, "v": s.v}),
        flow=flow,
    )


def _sets_a_signal(s: Any, p: Any) -> dict[str, Any]:
    s.x *= 2.0
    return {"x": s.v, "v": -p.k * s.x}


def _scales_a_local_name(s: Any, p: Any) -> dict[str, Any]:
    x = s.x
    x *= 2.0
    return {"x": s.v, "v": -p.k * x - p.c * s.v}


def _sets_elements(s: Any, p: Any) -> dict[str, Any]:
    s.x[...] = 0.0
    return {"x": s.v, "v": -p.k * s.x}


def _clips_by_a_mask(s: Any, p: Any) -> dict[str, Any]:
    x = np.asarray(s.x)
    if x.ndim:
        x[x > 3.0] = 3.0
    return {"x": s.v, "v": -p.k * x - p.c * s.v}


def _writes_into_out(s: Any, p: Any) -> dict[str, Any]:
    if np.ndim(s.x):
        np.multiply(s.x, 2.0, out=s.x)
    return {"x": s.v, "v": -p.k * s.x - p.c * s.v}


def _sets_a_parameter(s: Any, p: Any) -> dict[str, Any]:
    p.k += 1.0
    return {"x": s.v, "v": -p.k * s.x}


def _scales_a_parameter(s: Any, p: Any) -> dict[str, Any]:
    k = p.k
    k *= 2.0
    return {"x": s.v, "v": -k * s.x - p.c * s.v}


def _adds_a_signal(s: Any, p: Any) -> dict[str, Any]:
    s.spring = p.k * s.x
    return {"x": s.v, "v": -s.spring}


def _deletes_a_signal(s: Any, p: Any) -> dict[str, Any]:
    del s.force
    return {"x": s.v, "v": -p.k * s.x}


CHANGING = [
    _sets_a_signal,
    _scales_a_local_name,
    _sets_elements,
    _clips_by_a_mask,
    _writes_into_out,
    _sets_a_parameter,
    _scales_a_parameter,
    _adds_a_signal,
    _deletes_a_signal,
]


@pytest.mark.parametrize("rates", CHANGING, ids=lambda function: function.__name__)
def test_a_function_that_changes_its_arguments_is_refused_with_its_line(rates: Functions) -> None:
    with pytest.raises(
        ModelError,
        match=(
            r"rates \(.*test_own_arguments.py, line \d+\): it changes what it was given.*; make a "
            r"new value"
        ),
    ):
        spring(rates=rates)


@pytest.mark.parametrize("what", ["readings", "flow"])
def test_every_function_of_a_model_is_held_to_it(what: str) -> None:
    def changes(s: Any, p: Any) -> dict[str, Any]:
        v = s.v
        v *= 2.0
        return {"x": s.x, "v": v} if what == "readings" else {"twice": v}

    with pytest.raises(ModelError, match=rf"{what} .*it changes what it was given"):
        spring(**{what: changes})


def test_what_flow_formed_cannot_be_changed_by_the_others() -> None:
    def rates(s: Any, p: Any) -> dict[str, Any]:
        a = s.a
        a *= 2.0
        return {"x": s.v, "v": a}

    with pytest.raises(ModelError, match=r"rates .*it changes what it was given"):
        spring(rates=rates, flow=lambda s, p: {"a": -p.k * s.x - p.c * s.v})


@pytest.mark.parametrize("pushed", [False, True])
def test_a_change_in_a_branch_that_the_trial_does_not_take_is_refused_when_it_happens(
    pushed: bool,
) -> None:
    def rates(s: Any, p: Any) -> dict[str, Any]:
        x = s.x
        if np.any(np.real(x) > 3.0):
            x *= 2.0
        return {"x": s.v, "v": -p.k * x - p.c * s.v}

    model = spring(rates=rates)
    push = UnmeasuredInput(
        lasting=True, ports=("v_rate",), sizes=(0.1,), units=("m/s2",), needs_constants=()
    )
    system = compile_model(model.with_effects(push) if pushed else model)
    x = np.array([0.0, 5.0])
    p = system.parameters.values().tolist()
    with pytest.raises(ModelError, match="it changes what it was given"):
        system.f(0.0, [x, x], [0.0], p)
    assert x.tolist() == [0.0, 5.0] and x.flags.writeable


def test_arrays_of_the_caller_stay_writeable() -> None:
    x: Any = np.array([[0.1, 0.2], [0.0, 0.0]])
    k = np.array([4.0, 5.0])
    rates = compile_model(spring()).f(0.0, x, [0.0], [k, 0.5])
    assert np.array_equal(rates[1], -k * x[0]) and x.flags.writeable and k.flags.writeable


def test_an_array_that_is_overwritten_at_each_call_is_refused() -> None:
    store = np.zeros(2)

    def rates(s: Any, p: Any) -> dict[str, Any]:
        if np.shape(s.x) != (2,) or np.iscomplexobj(s.x):
            return {"x": s.v, "v": -p.k * s.x - p.c * s.v}
        store[:] = -p.k * s.x - p.c * s.v
        return {"x": s.v, "v": store}

    with pytest.raises(
        ModelError, match="the rate of v is the same array at every call; return a new array"
    ):
        spring(rates=rates)


TIMED: dict[str, Callable[[Any], Any]] = {
    "cosine": lambda t: np.cos(1.3 * t),
    "step": lambda t: where(t > 6.0, 1.0, 0.0),
    "ramp": lambda t: t - 2.0,
    "itself": lambda t: t,
    "array": lambda t: np.asarray(t) * 0.0,
    "square": lambda t: t**2,
    "number": lambda t: np.float64(t) if np.ndim(t) == 0 else t,
    "choice": lambda t: np.where(np.less(t, 3.0), 0.0, 1.0),
}


@pytest.mark.parametrize("share", TIMED.values(), ids=TIMED)
@pytest.mark.parametrize("place", ["rates", "readings", "flow"])
def test_equations_that_use_the_time_have_no_table(share: Callable[[Any], Any], place: str) -> None:
    model = spring(
        rates=lambda s, p: {
            "x": s.v,
            "v": s.force - p.c * s.v - p.k * s.x + (share(s.time) if place == "rates" else 0.0),
        },
        readings=lambda s, p: {
            "x": s.x,
            "v": s.v
            + (share(s.time) if place == "readings" else s.late if place == "flow" else 0.0),
        },
        flow=(lambda s, p: {"late": share(s.time)}) if place == "flow" else None,
    )
    system = compile_model(model)
    assert system_tables(system, system.parameters.values().tolist()) is None


def test_equations_without_the_time_have_a_table() -> None:
    for model in (spring(), roll()):
        system = compile_model(model)
        assert system_tables(system, system.parameters.values().tolist()) is not None


def test_a_watched_time_serves_as_a_number_and_records_its_use() -> None:
    for use in (
        float,
        complex,
        bool,
        np.asarray,
        np.sin,
        lambda t: t + 1.0,
        lambda t: 1.0 - t,
        lambda t: t > 0,
        lambda t: t.shape,
        lambda t: -t,
    ):
        time: Any = WatchedTime()
        assert not time.used
        use(time)
        assert time.used
    time = WatchedTime()
    assert (np.array([1.0, 2.0]) + time).tolist() == [1.0, 2.0]
