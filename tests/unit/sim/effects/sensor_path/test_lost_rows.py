"""Lost rows: the motion of two flights one after the other, and their trace in a record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exam import recorder_faults as faults
from ident.tracing.diagnosis import Verdict
from ident.tracing.loop import diagnose
from sim.declaration.proposal import SearchContext, Traceable
from sim.effects.library import catch_all_terms_for, effects_for
from sim.effects.sensor_path.lost_rows import MOST_STATES, LostRows, made_for
from sim.record import Channel, Record
from sim.vehicles.other_vehicles import Ballistic
from sim.vehicles.uncoupled import Loes, ShortPeriod
from tests.bases import (
    Flight,
    ballistic_flight,
    ballistic_model,
    fly_model,
    rigid_flight,
    rigid_model,
)

JUMP = {"lost-rows.alpha": 0.03, "lost-rows.q": -0.08}


def _flown_from(states: dict[str, float], flight: Flight) -> list[np.ndarray]:
    model = rigid_model()
    return fly_model(model.with_initial(model.initial.with_values(states)), flight)


def test_behind_the_jump_the_flight_is_one_from_the_new_states() -> None:
    """The oracle flies the two parts by themselves: the second starts from the states that the
    first had at ``start``, plus the jumps.
    """
    model, flight = rigid_model(), rigid_flight()
    interval = float(flight.time[1] - flight.time[0])
    row = 120
    start = float(flight.time[row]) + 0.5 * interval
    effect = replace(made_for(model.equations)[0], width=0.5 * interval)
    got = fly_model(
        model.with_effects(effect).with_values({"lost-rows.start": start, **JUMP}), flight
    )
    names = [signal.name for signal in model.equations.outputs]
    alpha, q = (fly_model(model, flight)[names.index(name)] for name in ("alpha", "q"))
    # the jump in the middle of an interval, carried back to its begin by the free motion
    fine = Flight(flight.time[row] + interval * np.array([0.0, 0.5]), flight.u[:, [row, row]])
    first = _flown_from({"alpha": alpha[row], "q": q[row]}, fine)
    middle = {
        "alpha": first[names.index("alpha")][1] + JUMP["lost-rows.alpha"],
        "q": first[names.index("q")][1] + JUMP["lost-rows.q"],
    }
    rest = Flight(
        np.concatenate([[start], flight.time[row + 1 :]]),
        np.column_stack([flight.u[:, row], flight.u[:, row + 1 :]]),
    )
    second = _flown_from(middle, rest)
    for place, name in enumerate(names):
        largest = np.max(np.abs(got[place]))
        np.testing.assert_allclose(
            got[place][row + 1 :], second[place][1:], rtol=0.0, atol=2e-3 * largest, err_msg=name
        )
    np.testing.assert_array_equal(alpha[:row], got[names.index("alpha")][:row])


@pytest.mark.parametrize("equations", [ShortPeriod(), Loes(), Ballistic()])
def test_all_states_jump_and_a_step_of_the_record_is_their_width(
    equations: ShortPeriod | Loes | Ballistic,
) -> None:
    (effect,) = [each for each in effects_for(equations) if isinstance(each, LostRows)]
    assert effect.states_read == tuple(signal.name for signal in equations.states)
    context = SearchContext(0.0, 10.0, 0.05, flown={effect.states_read[0]: (-0.2, 0.6)})
    form = effect.fitted_to(context)
    assert form.width == 0.025
    assert form.sizes[0] == pytest.approx(0.4)
    assert len(equations.states) <= MOST_STATES


def test_a_body_without_inputs_is_later_by_the_lost_time() -> None:
    """The oracle flies through the gap and takes the rows behind it."""
    model, flight = ballistic_model(), ballistic_flight()
    (effect,) = made_for(model.equations)
    assert [item.name for item in effect.parameters] == ["start", "lost"]
    interval = float(flight.time[1] - flight.time[0])
    row, rows = 40, 7
    start = float(flight.time[row]) + 0.5 * interval
    form = replace(effect, width=0.5 * interval)
    known = {"lost-rows.start": start, "lost-rows.lost": rows * interval}
    got = fly_model(
        model.with_effects(form).with_values(known), replace(flight, max_step=0.125 * interval)
    )
    whole = fly_model(model, flight)
    for row_got, row_whole in zip(got, whole, strict=True):
        largest = np.max(np.abs(row_whole))
        np.testing.assert_allclose(
            row_got[row + 1 : -rows], row_whole[row + 1 + rows :], rtol=0.0, atol=1e-6 * largest
        )
        np.testing.assert_allclose(row_got[:row], row_whole[:row], rtol=1e-12)


def test_lost_rows_are_traced_to_the_row() -> None:
    """Rows are cut out of flown records and the times made even again."""
    rng, noise = np.random.default_rng(5), {"alpha": 0.002, "q": 0.003, "nz": 0.02}
    model, flight = rigid_model(), rigid_flight()
    rows = dict(
        zip([s.name for s in model.equations.outputs], fly_model(model, flight), strict=True)
    )
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    records, spell = [], {"begin": 3.1, "length": 0.5}
    for _ in range(2):
        whole = Record(
            time=flight.time,
            inputs=(Channel.of("elevator", "rad", flight.u[0]),),
            outputs=tuple(
                Channel.of(name, units[name], rows[name] + rng.normal(0.0, std, len(flight.time)))
                for name, std in noise.items()
            ),
        )
        records.append(faults.rows_lost(whole, spell, rng))
    candidates = [each for each in effects_for(model.equations) if isinstance(each, Traceable)]
    found = diagnose(
        records[:1], model, candidates, catch_all_terms_for(model.equations), records[1:]
    )
    assert found.verdict is Verdict.TRACED
    (claim,) = [each for each in found.effects if each.claimed]
    assert claim.name == "lost-rows"
    interval = float(flight.time[1] - flight.time[0])
    assert abs(claim.parameters["start"].value - spell["begin"]) < 1.5 * interval
    before = int(np.searchsorted(flight.time, spell["begin"]))
    after = int(np.searchsorted(flight.time, spell["begin"] + spell["length"]))
    for name in ("alpha", "q"):
        jump, found_jump = rows[name][after] - rows[name][before], claim.parameters[name]
        # the two rows are an interval apart, in which the motion goes on
        slope = np.max(np.abs(np.diff(rows[name][before - 1 : after + 2])))
        assert abs(found_jump.value - jump) < 3.0 * found_jump.std + slope
