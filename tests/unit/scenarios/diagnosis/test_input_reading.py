"""When held inputs are read again as moving between samples, and how that is said."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ident.tracing.diagnosis import Claim, Quantity, Trained, Verdict
from ident.whole_record.layout import FitSettings
from scenarios.diagnosis.opening import (
    Refit,
    has_fitted_times,
    notes_of_reread,
    with_sigmas_of_both,
)
from scenarios.preparation.plan import BY_HAND
from sim.effects.sensor_path.sensor_mounting import VaneOffset
from sim.record import Hold
from tests.diagnoses import measured_record, tracing_of


def test_the_second_reading_was_chosen_by_no_hand() -> None:
    notes = (f"inputs linear between samples: {BY_HAND}", "a trim was taken off")
    first, second = notes_of_reread(notes)
    assert BY_HAND not in first and "--hold previous" in first and second == notes[1]


def test_times_found_with_held_inputs_ask_for_a_second_reading() -> None:
    record = measured_record()
    late = Claim("sensor-delay:alpha", {"delay": Quantity(0.05, 0.001, "s")})
    found = replace(tracing_of(Verdict.TRACED).diagnosis, effects=(late,))
    assert has_fitted_times(found, [record])
    assert not has_fitted_times(found, [replace(record, hold=Hold.LINEAR)])
    vane = Claim("vane-offset", {"arm": Quantity(3.0, 0.1, "m")})
    assert not has_fitted_times(replace(found, effects=(vane,)), [record])
    hint = replace(late, claimed=False)
    boom = Trained((VaneOffset(),), ("alpha",), {}, ({},), FitSettings())
    other = replace(found, effects=(vane, hint), trained_after=boom)
    assert not has_fitted_times(other, [record]), "the hint belongs to another set"


def test_where_both_readings_serve_what_differs_is_told_and_sigmas_hold_both() -> None:
    """Half an interval of 0.02 s is ten sigmas of a delay; nothing is told where one of the two
    readings fits clearly better, or where nothing moves.
    """
    late = Claim("sensor-delay:q", {"delay": Quantity(0.09, 0.001, "s")})
    first = replace(
        tracing_of(Verdict.TRACED).diagnosis,
        effects=(late,),
        after={"Cm_q": Quantity(-12.0, 0.3, "1/rad")},
    )
    moved = {"sensor-delay:q.delay": 0.10, "Cm_q": -12.4}
    both, (told,) = with_sigmas_of_both(Refit(0.0, moved), first)
    assert "sensor-delay:q.delay 0.1 for 0.09" in told and "--hold linear" in told
    (found,) = both.effects
    # Two values, equally probable, and the scatter of each: the mean square about the first.
    assert found.parameters["delay"].value == 0.09
    assert found.parameters["delay"].std ** 2 == pytest.approx(0.001**2 + 0.5 * 0.01**2)
    assert both.after["Cm_q"].std ** 2 == pytest.approx(0.3**2 + 0.5 * 0.4**2)
    likelier, _ = with_sigmas_of_both(Refit(6.0, moved), first)
    share = 1.0 / (1.0 + math.exp(-3.0))
    assert likelier.effects[0].parameters["delay"].std ** 2 == pytest.approx(
        0.001**2 + share * 0.01**2
    )
    still = {"sensor-delay:q.delay": 0.0905, "Cm_q": -12.1}
    for again in (
        Refit(0.0, still),
        Refit(-11.0, moved),
        Refit(11.0, moved),
        Refit(-math.inf, {}),
    ):
        assert with_sigmas_of_both(again, first) == (first, ())
