"""Every mistake in the declaration of a model is one line that says what, where and what to do."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from sim.errors import ModelError
from sim.maths import absolute, clip, maximum, where
from tests.own_models import ROLL_DECLARED, roll


def rated(p: Any) -> dict[str, Any]:
    """The roll with another rate of p, a function of s and p."""
    return {"rates": lambda s, q: {"p": p(s, q), "phi": s.p}}


FAULTS: list[tuple[dict[str, Any], str]] = [
    ({"name": ""}, "own model: '' is no name; "),
    ({"name": "two\nlines"}, "own model: 'two\\nlines' is no name; "),
    ({"states": {}}, "model roll: there is no state; "),
    ({"outputs": {}}, "model roll: there is no output; "),
    ({"states": ["p"]}, "model roll: states is of type list; "),
    ({"ports": ["p"]}, "model roll: ports is of type list; "),
    ({"states": {"1p": "rad"}}, "model roll, states: '1p' is no name; "),
    ({"states": {"_p": "rad"}}, "model roll, states: '_p' is no name; "),
    ({"states": {3: "rad"}}, "model roll, states: 3 is no name; "),
    ({"states": {"class": "rad"}}, "model roll, states: 'class' is a word of Python itself; "),
    ({"states": {"p": " "}}, "model roll, states, p: the unit is empty; "),
    ({"states": {"p": 3}}, "model roll, states, p: the unit is of type int; "),
    ({"states": {"time": "s"}}, "model roll, states: 'time' is the time as well; "),
    ({"inputs": {"p": "rad"}}, "model roll, inputs: 'p' is among the states as well; "),
    ({"ports": {"aileron": "rad"}}, "model roll, ports: 'aileron' is among the inputs as well; "),
    (
        {"states": {"p": "rad/s", "phi": "rad", "p_rate": "1"}},
        "model roll, ports: 'p_rate' is among the states as well; ",
    ),
    (
        {"constants": {"phi": (1.0, "1")}},
        "model roll, constants: 'phi' is among the states as well; ",
    ),
    (
        {"parameters": {"airspeed": (1.0, "1")}},
        "model roll, parameters: 'airspeed' is among the constants as well; ",
    ),
    (
        {"outputs": {"aileron": "rad"}},
        "model roll, outputs: 'aileron' is among the inputs as well; ",
    ),
    (
        {"outputs": {"p": "deg/s"}, "readings": lambda s, p: {"p": 57.3 * s.p}},
        "model roll, outputs, p: the unit is deg/s, that of the state of this",
    ),
    (
        {"readings": lambda s, p: {"p": s.p, "phi": 57.3 * s.phi}},
        "phi: it has the name of a state and reads something else (it moves 57.3 times",
    ),
    (
        {"readings": lambda s, p: {"p": s.phi, "phi": s.phi}},
        "p: it has the name of a state and reads something else (it moves 0 times",
    ),
    (
        {"parameters": {"bias_p": (1.0, "1")}},
        "model roll, parameters: 'bias_p' would be taken for a sensor's bias; ",
    ),
    ({"parameters": ["L_p"]}, "model roll: parameters is of type list; "),
    (
        {"parameters": {"L_p": -2.0}},
        "model roll, parameters, L_p: -2.0 is no pair of a start and a unit; ",
    ),
    ({"parameters": {"L_p": ("-2", "1/s")}}, "model roll, parameters, L_p: '-2' is no number; "),
    ({"parameters": {"L_p": (True, "1/s")}}, "model roll, parameters, L_p: True is no number; "),
    ({"parameters": {"L_p": (1j, "1/s")}}, "model roll, parameters, L_p: 1j is no number; "),
    (
        {"parameters": {"L_p": (math.nan, "1/s")}},
        "model roll, parameters, L_p: nan is no finite number; ",
    ),
    (
        {"constants": {"airspeed": (60.0, "")}},
        "model roll, constants, airspeed: the unit is empty; ",
    ),
    ({"bounds": {"L_r": (0, 1)}}, "model roll, bounds: there is no parameter 'L_r'; "),
    ({"bounds": {"L_p": 1.0}}, "model roll, bounds, L_p: 1.0 is no pair of bounds; "),
    ({"bounds": {"L_p": (1, 0)}}, "model roll, bounds, L_p: 1 is not below 0; "),
    ({"bounds": {"L_p": (0, 1)}}, "parameter L_p: value -2 1/s lies outside [0, 1]; "),
    ({"initial": {"r": 1.0}}, "model roll, initial: there is no state 'r'; "),
    ({"initial": {"p": "1"}}, "model roll, initial, p: '1' is no number; "),
    ({"initial": [1.0]}, "model roll: initial is of type list; "),
    ({"biases": "p"}, "model roll: biases is of type str; "),
    ({"biases": ["r"]}, "model roll, biases: there is no output 'r'; "),
    ({"rates": None}, "model roll: rates is of type NoneType and cannot be called; "),
    ({"readings": {"p": 1.0}}, "model roll: readings is of type dict and cannot be called; "),
    ({"rates": lambda s, p: {"p": s.p}}, "model roll, rates: phi missing; "),
    (
        {"rates": lambda s, p: {"p": s.p, "phi": s.p, "r": 1.0}},
        "model roll, rates: there is no state 'r'; ",
    ),
    (
        {"rates": lambda s, p: [s.p, s.phi]},
        "model roll, rates: it returns a list, not a mapping by name; ",
    ),
    ({"readings": lambda s, p: {"p": s.p}}, "model roll, readings: phi missing; "),
    (
        {"flow": lambda s, p: None},
        "model roll, flow: it returns a NoneType, not a mapping by name; ",
    ),
    ({"flow": lambda s, p: {"p": 1.0}}, "model roll, flow: p is a signal or parameter already; "),
    (
        {"flow": lambda s, p: {"L_p": 1.0}},
        "model roll, flow: L_p is a signal or parameter already; ",
    ),
    ({"flow": lambda s, p: {"a b": 1.0}}, "model roll, flow: 'a b' is no name; "),
    (rated(lambda s, p: s.q), ": there is no signal s.q; declare it, or use one of "),
    (rated(lambda s, p: p.Lp * s.p), ": there is no parameter p.Lp; did you mean 'L_p'?"),
    (rated(lambda s, p: dict.fromkeys("q", s.p)["x"]), ": rates gives no 'x'; "),
    (rated(lambda s, p: undefined), (": NameError: name 'undefined' is not defined; ")),  # type: ignore[name-defined]  # noqa: F821
    (rated(lambda s, p: 1.0 / s.p), ": ZeroDivisionError: "),
    (rated(lambda s, p: math.nan), "model roll, rates: the rate of p is nan at the starts; "),
    (
        {"readings": lambda s, p: {"p": math.inf, "phi": s.phi}},
        "model roll, readings: the reading of p is inf at the starts; ",
    ),
    (rated(lambda s, p: "0.1"), "model roll, rates: the rate of p is of type str; "),
    (rated(lambda s, p: None), "model roll, rates: the rate of p is of type NoneType; "),
    (rated(lambda s, p: math.sin(s.p)), ": TypeError: must be real number, not complex; use sin, "),
    (rated(lambda s, p: float(s.p)), ": TypeError: "),
    (
        rated(lambda s, p: np.ones(3)),
        "model roll, rates: the rate of p of shape (3,) where all signals are single numbers; ",
    ),
    ({"rates": lambda s: {"p": s.p, "phi": s.p}}, "model roll, rates: it takes (s), not (s, p); "),
    (
        {"readings": lambda s, p, t: {"p": s.p, "phi": s.phi}},
        "model roll, readings: it takes (s, p, t), not (s, p); ",
    ),
    ({"flow": lambda: {}}, "model roll, flow: it takes (), not (s, p); "),
    (rated(lambda s, p: s.p if s.p > 0 else 0.0), ": TypeError: '>' not supported"),
    (rated(lambda s, p: max(s.p, 0.0)), ": TypeError: '>' not supported"),
    (
        rated(lambda s, p: abs(s.p)),
        ": the rate of p loses a complex step of p: the slope is 1, not 0; use sin, ",
    ),
    (rated(lambda s, p: s.p * abs(s.p)), ": the rate of p loses a complex step of p: "),
    (rated(lambda s, p: p.L_p.real * s.p), ": the rate of p loses a complex step of L_p: "),
    (rated(lambda s, p: s.p if s.p else 0.0 * s.p), ": ValueError: The truth value of an array"),
]


@pytest.mark.parametrize(
    ("changes", "line"), FAULTS, ids=[line[:60].strip(" ;:") for _, line in FAULTS]
)
def test_one_line_on_each_mistake(changes: dict[str, Any], line: str) -> None:
    with pytest.raises(ModelError) as caught:
        roll(**changes)
    message = str(caught.value)
    # where the function begins
    plain = re.sub(r"(model \w+, \w+) \([^)]*test_own_model_faults\.py, line \d+\)", r"\1", message)
    assert (
        (line in message or line in plain) and "\n" not in message and len(caught.value.remedy) > 4
    )
    if re.match(r"model roll, (rates|readings|flow): ", line):
        assert plain != message, "a fault of a function has its line"
    if line.startswith(": "):
        assert "test_own_model_faults.py, line " in message and message.startswith(
            "model roll, rates ("
        )


@pytest.mark.parametrize(
    "rate",
    [
        lambda s, p: absolute(s.p) * s.p,
        lambda s, p: clip(s.p, -0.1, 0.1),
        lambda s, p: maximum(s.p, 0.0 * s.p),
        lambda s, p: where(s.p.real > 0.0, p.L_p * s.p, 0.0 * s.p),
        lambda s, p: p.L_p * s.p**3 + 1e6 * s.aileron,
        lambda s, p: 0.0,
    ],
)
def test_what_passes_is_not_refused(rate: Any) -> None:
    assert roll(**rated(rate)).name == ROLL_DECLARED["name"]
