"""Ties: a tied model is the free one with the numbers put in by hand, in every function and in a
fit.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.declaration.model import Tie
from sim.errors import ModelError
from sim.propagation import drive_from_record, make_grid, simulate
from tests.every_model import case_of
from tests.loes_problem import record
from tests.rigid_problem import rigid_record, rigid_start

TIE = Tie("Cm_q", (("Cm_alpha", 20.0), ("CL_alpha", -0.5)), -0.3)


def test_every_function_sees_what_the_tie_gives() -> None:
    plain, tied = compile_model(rigid_start()), compile_model(rigid_start().with_ties([TIE]))
    p = np.random.default_rng(0).normal(1.0, 0.1, len(plain.parameters)) * plain.parameters.values()
    at = plain.parameters.index
    by_hand = p.copy()
    by_hand[at("Cm_q")] = 20.0 * p[at("Cm_alpha")] - 0.5 * p[at("CL_alpha")] - 0.3
    x, u = [0.03, 0.2], [0.05]
    assert (
        tied.f(0.0, x, u, p.tolist())
        == plain.f(0.0, x, u, by_hand.tolist())
        != plain.f(0.0, x, u, p.tolist())
    )
    assert tied.h(0.0, x, u, p.tolist()) == plain.h(0.0, x, u, by_hand.tolist())
    # Arrays of values and complex steps go through as numbers do.
    rows = [np.array([value, 2.0 * value + 1e-30j]) for value in p]
    rows_by_hand = [*rows]
    rows_by_hand[at("Cm_q")] = 20.0 * rows[at("Cm_alpha")] - 0.5 * rows[at("CL_alpha")] - 0.3
    assert all(
        np.array_equal(a, b)
        for a, b in zip(tied.f(0.0, x, u, rows), plain.f(0.0, x, u, rows_by_hand), strict=True)
    )


def test_the_tied_parameter_is_held_at_its_tie() -> None:
    model = rigid_start().with_ties([TIE])
    start = rigid_start().parameters
    assert not model.parameters["Cm_q"].free
    assert model.parameters["Cm_q"].value == pytest.approx(
        20.0 * start["Cm_alpha"].value - 0.5 * start["CL_alpha"].value - 0.3
    )
    moved = model.with_values({"Cm_alpha": -1.0, "Cm_q": 5.0})
    assert moved.parameters["Cm_q"].value == pytest.approx(
        -20.0 - 0.5 * start["CL_alpha"].value - 0.3
    ), "it follows, whatever it is given"
    assert TIE.words == "Cm_q = 20 Cm_alpha - 0.5 CL_alpha - 0.3"


def test_a_delay_may_follow_and_be_followed() -> None:
    """Which parameters move the input path and the dynamics follows from the ties."""
    case = case_of("loes")
    from scenarios.preparation.declared_model import model_of_file

    model = model_of_file(case.vehicle)
    late = compile_model(model.with_ties([Tie("delay", (("inv_tau", 0.01),))]))
    assert {"delay", "inv_tau"} <= late.input_parameters
    flown = record(0)
    p = late.parameters.values()
    p[late.parameters.index("inv_tau")] = 11.8
    grid = make_grid(flown.time, 0.01)

    def outputs(system, values):
        drive = drive_from_record(
            system, values, flown.input_array(system.input_names), flown.time, flown.hold, grid
        )
        return np.array(simulate(system, values, system.initial.values().tolist(), drive, grid))

    by_hand = p.copy()
    by_hand[late.parameters.index("delay")] = 0.118
    assert np.array_equal(
        outputs(late, p.tolist()), outputs(compile_model(model), by_hand.tolist())
    )


def test_a_fit_finds_the_truth_with_fewer_unknowns() -> None:
    """Cm_q is 20.93 times Cm_alpha in truth: the tie is right, and what it follows is known better
    for it.
    """
    model, flown = (
        rigid_start().with_biases(["alpha", "q", "nz"]),
        rigid_record(np.random.default_rng(1)),
    )
    free = fit_output_error([flown], compile_model(model))
    tied = fit_output_error(
        [flown], compile_model(model.with_ties([Tie("Cm_q", (("Cm_alpha", 34.75 / 1.66),))]))
    )
    assert "Cm_q" not in tied.names and tied.sigma("Cm_alpha") < free.sigma("Cm_alpha")
    assert abs(tied.value("Cm_alpha") + 1.66) < 4.0 * tied.sigma("Cm_alpha")


@pytest.mark.parametrize(
    ("ties", "said"),
    [
        ([Tie("Cm_x", (("Cm_q", 1.0),))], "Cm_x: there is no such parameter"),
        ([Tie("Cm_q", (("Cm_x", 1.0),))], "Cm_x: there is no such parameter"),
        ([Tie("Cm_q", (("Cm_q", 1.0),))], "tie of Cm_q: Cm_q is tied itself"),
        (
            [Tie("Cm_q", (("Cm_de", 1.0),)), Tie("Cm_de", (("CL_de", 1.0),))],
            "tie of Cm_q: Cm_de is tied itself",
        ),
        (
            [Tie("Cm_q", (("Cm_de", 1.0),)), Tie("Cm_q", (("CL_de", 1.0),))],
            "tie of Cm_q: tied twice",
        ),
        ([Tie("Cm_q", ())], "tie of Cm_q: no finite numbers"),
        ([Tie("Cm_q", (("Cm_de", np.inf),))], "tie of Cm_q: no finite numbers"),
    ],
)
def test_wrong_ties_are_refused(ties: list[Tie], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        rigid_start().with_ties(ties)
