"""One candidate tried on records that were left out: what two records, and a witness, change in the bars that it has to pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.diagnosis import Quantity
from ident.tracing.replication import one_round
from ident.tracing.replication.by_record import Flight, Replication
from ident.tracing.replication.comparison import CrossValidation
from ident.tracing.replication.error_reduction import Reduction
from ident.tracing.replication.weighing import Trial, _replicates, _worth, left_out, try_out, weigh
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.witness import Silent
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import all_records, coloured, doublets, planted, root_of

LATE, DRIFT = SensorDelay("alpha"), SensorDrift("nz", "g", 5e-3)
DELAYED = {"sensor-delay:alpha.delay": 0.08}


def flown(effect: Traceable, values: Sequence[Mapping[str, float]], colour: float = 1.0) -> Flight:
    """Coloured records of 10 s, one for each of some values."""
    return all_records([coloured(planted([effect], each, r, flight=doublets(10.0, 25.0)), r, colour) for r, each in enumerate(values, start=1)])


def weighed(flight: Flight, effect: Traceable) -> CrossValidation:
    """The candidate, tried beside nothing."""
    root = root_of(flight)
    (finding,), before = screen(root, [effect], search_context(root)), left_out(flight, root)
    assert before is not None
    found = weigh(flight, root, finding, before)
    assert found is not None
    return found


class Witness(Silent):
    """Speaks for any effect by so much log likelihood, and remembers what it was asked."""

    def __init__(self, says: float) -> None:
        self.says, self.asked = says, list[str]()

    def against(self, effect: str, parameters: Mapping[str, Quantity], /) -> float:
        return max(0.0, -self.evidence(effect, parameters))

    def evidence(self, effect: str, parameters: Mapping[str, Quantity], /) -> float:
        self.asked.append(effect)
        assert all(quantity.std > 0.0 for quantity in parameters.values())
        return self.says


@pytest.fixture(scope="module")
def late() -> Flight:
    return flown(LATE, [DELAYED] * 3)


def test_a_witness_is_asked_when_all_candidates_are_fitted(late: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    """It makes its computation meanwhile."""
    steps: list[str] = []
    witness = Witness(0.0)

    def fitted(*arguments: Any) -> Trial | None:
        steps.append("fitted" if not witness.asked else "fitted late")
        return try_out(*arguments)

    monkeypatch.setattr(one_round, "try_out", fitted)
    tried = one_round.weigh_all(replace(late, witness=witness), [LATE, SensorScale("alpha"), DRIFT], root_of(late))
    assert tried is not None and tried.chosen is not None and witness.asked
    assert len(steps) > 1 and set(steps) == {"fitted"}


def test_of_what_belongs_to_each_of_two_records_nothing_stands_and_with_three_it_does() -> None:
    slopes = [{"sensor-drift:nz.slope": slope} for slope in (0.03, -0.03, 0.03)]
    two, three = (weighed(flown(DRIFT, slopes[:count]), DRIFT) for count in (2, 3))
    assert three.stands and three.gain > 100.0 and two.gain > 100.0
    assert not two.stands and two.why == "of two records, each with its own value, nothing replicates"


def test_what_any_record_may_have_needs_no_third_one() -> None:
    """A phugoid in both: no aircraft is without."""
    values = [{"phugoid.attitude": attitude, "phugoid.induced_drag": 4.0} for attitude in (0.09, -0.08)]
    assert Phugoid().traits.background and weighed(flown(Phugoid(), values, 0.3), Phugoid()).stands


def test_with_two_records_an_effect_has_to_explain_most_of_what_each_leaves(late: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    two = flown(LATE, [DELAYED] * 2, 0.3)
    assert weighed(two, LATE).stands
    for share, expected in ((thresholds.MOST_OF_IT + 0.01, True), (thresholds.MOST_OF_IT - 0.01, False)):
        monkeypatch.setattr("ident.tracing.replication.weighing.explained_share", lambda before, after, share=share: share)
        found = weighed(two, LATE)
        assert found.stands is expected and ("of what they leave" in found.why) is not expected
    assert weighed(late, LATE).stands, "three records are asked for replication alone"


def test_it_has_to_be_half_of_each_record_not_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    two = flown(LATE, [DELAYED] * 2, 0.3)
    shares = iter((0.99, thresholds.HALF_OF_IT - 0.1, 0.9))
    monkeypatch.setattr("ident.tracing.replication.weighing.explained_share", lambda before, after: next(shares))
    assert not weighed(two, LATE).stands


def test_a_strong_witness_halves_what_the_error_has_to_fall_by(late: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fall that is there lies between the bar and half of it."""
    monkeypatch.setattr(thresholds, "WORTH", -1.3 * weighed(late, LATE).reduction.total)
    for says, stands in ((0.0, False), (0.9 * thresholds.STRONG_WITNESS, False), (1.1 * thresholds.STRONG_WITNESS, True)):
        found = weighed(replace(late, witness=Witness(says)), LATE)
        assert found.stands is stands and ("does not lower the error" in found.why) is not stands


def test_a_strong_witness_forbids_what_passes_all_else_and_is_asked_only_then(late: Flight) -> None:
    for says, stands in ((-0.9 * thresholds.STRONG_WITNESS, True), (-1.1 * thresholds.STRONG_WITNESS, False)):
        witness = Witness(says)
        found = weighed(replace(late, witness=witness), LATE)
        assert found.stands is stands and (found.why == "the kinematics speak against it") is not stands
        assert witness.asked == [LATE.name]
    unasked = Witness(-1e9)
    two = flown(DRIFT, [{"sensor-drift:nz.slope": slope} for slope in (0.03, -0.03)])
    assert not weighed(replace(two, witness=unasked), DRIFT).stands and unasked.asked == []


@pytest.mark.parametrize(("rise", "scatter", "passes"), [(0.03, 0.005, True), (0.08, 0.005, False), (0.08, 0.02, True), (0.2, 0.05, False)])
def test_a_record_may_rise_by_a_twentieth_beyond_chance(rise: float, scatter: float, passes: bool) -> None:
    """One that hardly moves what the effect needs shows what small causes do with it, however sure that is."""
    lowered = Reduction(-0.3, 0.05, np.full(3, -0.3), np.full(3, 0.05), (-0.5, -0.4, rise), (0.1, 0.1, scatter))
    stands, why = _replicates(lowered, Replication((), True))
    assert stands is passes and why == ("cross-validated" if passes else "it makes a record worse")


def test_what_is_learnt_from_the_record_that_is_left_out_has_to_bring_twice_as_much() -> None:
    flight = all_records([planted([], None, seed) for seed in (1, 2, 3)])
    root = root_of(flight)
    lowered = Reduction(-0.15, 0.01, np.full(3, -0.15), np.full(3, 0.01), (-0.15,) * 3, (0.01,) * 3)
    for effect, least in ((SensorScale("q"), 1.0), (SensorDrift("q", "rad/s", 0.001), thresholds.STRONGLY)):
        child = flight.fit((effect,), range(3), root.values)
        assert child is not None and _worth(flight, child, effect, lowered) == pytest.approx(least * thresholds.WORTH)
