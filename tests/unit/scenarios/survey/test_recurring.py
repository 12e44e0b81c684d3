"""Which effects recur, over flights that were made up: against the likelihood of all samples at
once, found by brute force.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from ident.pooling import FALSE_RECURRENCE_PROBABILITY
from scenarios.survey.recurring import (
    candidates,
    effects_of_one_flight,
    recurrence_of_effect,
    recurring,
    starts_of,
)
from tests.unit.scenarios.survey.made_up import Flown, flown, kept

NONE = frozenset[str]()


def fleet(
    seed: int,
    count: int,
    values: dict[str, Sequence[float]],
    size: float = 1.0,
    also: Sequence[str] = (),
    parameters: int = 1,
) -> list[Flown]:
    """Flights on which an effect acts with ``values`` of each (zero: not), ``size`` its
    regressor's; ``also``: effects that act nowhere.
    """
    rng = np.random.default_rng(seed)
    out = []
    for number in range(count):
        effects = {name: size * rng.standard_normal((60, parameters)) for name in (*values, *also)}
        acts = {
            name: [value[number]] * parameters for name, value in values.items() if value[number]
        }
        out.append(flown(rng, effects, acts))
    return out


def every_sample(
    flights: Sequence[Flown], name: str
) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Common value, share, log likelihood and probabilities from the samples: each flight has the
    effect with that value, or has it not.
    """
    plain = np.array([each.least_cost() for each in flights])

    def gains(value: np.ndarray) -> np.ndarray:
        return plain - np.array([each.least_cost(each.effects[name] @ value) for each in flights])

    def cost(at: np.ndarray) -> float:
        return -float(np.logaddexp(log_expit(-at[0]), log_expit(at[0]) + gains(at[1:])).sum())

    width = flights[0].effects[name].shape[1]
    starts = [
        np.array([logit, *[value] * width])
        for logit in (-2.0, 2.0)
        for value in (-1.0, 0.3, 1.0, 2.0)
    ]
    options = {"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000}
    best = min(
        (minimize(cost, start, method="Nelder-Mead", options=options) for start in starts),
        key=lambda each: each.fun,
    )
    share = float(expit(best.x[0]))
    return best.x[1:], share, -best.fun, expit(gains(best.x[1:]) + best.x[0])


@pytest.mark.sampled
@pytest.mark.parametrize(("size", "parameters"), [(0.35, 1), (0.6, 1), (0.35, 2)])
def test_value_share_and_probabilities_are_those_of_all_samples(
    size: float, parameters: int
) -> None:
    flights = fleet(1, 10, {"delay": [1.0, 0.0] * 5}, size, parameters=parameters)
    found = recurrence_of_effect([each.fits() for each in flights], "delay", [NONE] * 10)
    value, share, total, probability = every_sample(flights, "delay")
    assert found is not None
    assert found.scatter == 0.0
    assert found.value == pytest.approx(value, abs=2e-3)
    assert found.share == pytest.approx(share, abs=3e-3)
    assert found.log_likelihood == pytest.approx(total, abs=1e-3)
    assert found.probability == pytest.approx(probability, abs=3e-3)


def test_what_acts_is_found_in_its_flights_and_nothing_else() -> None:
    here, there = [1.0, 0.0] * 6, [0.7] * 12
    flights = fleet(2, 12, {"delay": here, "arm": there}, also=["lag"])
    claims: list[dict[str, list[str]]] = [
        {"delay": ["lag"]} if value else {"arm": ["lag"]} for value in here
    ]
    names = tuple(kept(claims))
    found, sets = recurring(
        ("delay", "arm", "lag"), names, [each.fits() for each in flights], kept(claims)
    )
    assert {each.name: each.recurrence.belongs for each in found} == {
        "delay": "some flights",
        "arm": "aircraft",
    }
    assert sets == [frozenset({"arm", "delay"} if value else {"arm"}) for value in here]
    by_name = {each.name: each for each in found}
    assert by_name["delay"].has == names[::2]
    assert by_name["delay"].has_not == names[1::2]
    assert by_name["delay"].undecided == ()
    assert by_name["delay"].named == names[::2]
    for name, true in (("delay", 1.0), ("arm", 0.7)):
        each = by_name[name]
        assert abs(each.recurrence.value[0] - true) < 4.0 * np.sqrt(
            each.recurrence.covariance[0, 0]
        )
        assert each.rivals["lag"] > 10.0
        assert each.recurrence.p_value < FALSE_RECURRENCE_PROBABILITY


def test_the_common_sigma_holds_over_fleets() -> None:
    off = []
    for seed in range(30):
        found = recurrence_of_effect(
            [each.fits() for each in fleet(100 + seed, 8, {"arm": [0.5] * 8})], "arm", [NONE] * 8
        )
        assert found is not None
        off.append((found.value[0] - 0.5) / np.sqrt(found.covariance[0, 0]))
    assert abs(np.mean(off)) < 3.5 / np.sqrt(30)
    assert 0.65 < np.std(off) < 1.45  # 30 draws: 1 +- 0.13


@pytest.mark.parametrize(
    "seeds", [range(3), pytest.param(range(3, 30), marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_fleets_without_it_show_no_recurrence(seeds: range) -> None:
    for seed in seeds:
        flights = fleet(200 + seed, 12, {}, also=["delay", "arm", "lag"])
        # whatever the flights name by chance
        claims: list[dict[str, list[str]]] = [{"delay": ["lag", "arm"]}, {"arm": []}] * 6
        found, sets = recurring(
            ("delay", "arm", "lag"),
            tuple(kept(claims)),
            [each.fits() for each in flights],
            kept(claims),
        )
        assert found == []
        assert sets == [NONE] * 12


def test_an_arm_is_told_from_a_lag_by_all_flights_together() -> None:
    """An arm of one length, and a lag whose regressor is the same but for the airspeed: as a time
    it is another one on each flight.
    """
    rng = np.random.default_rng(3)
    fits = []
    for _ in range(12):
        arm = rng.standard_normal((60, 1))
        fits.append(
            flown(rng, {"arm": arm, "lag": rng.uniform(0.7, 1.6) * arm}, {"arm": [1.5]}).fits()
        )
    claims = [{"lag": ["arm"]}] * 12  # each flight alone names the wrong one
    found, _ = recurring(("lag", "arm"), tuple(kept(claims)), fits, kept(claims))
    assert [each.name for each in found] == ["arm"]
    assert found[0].rivals["lag"] > 10.0


def test_equal_names_are_told_by_the_derivatives_that_agree() -> None:
    """Two effects of one regressor; the wrong one takes a share of the lift with it that hangs on
    the airspeed.
    """
    rng = np.random.default_rng(4)
    fits = []
    for _ in range(10):
        arm, shift = rng.standard_normal((60, 1)), rng.uniform(0.2, 0.6)
        one = flown(rng, {"arm": arm}, {"arm": [1.5]})
        # spans the same, so that it is as likely
        other = Flown(one.y, one.design, {"mount": arm + shift * one.design[:, :1]})
        told = one.fits()
        told["effects"] |= other.fits()["effects"]
        told["sets"]["mount"] = other.fits()["sets"]["mount"]
        fits.append(told)
    claims = [{"mount": ["arm"]}] * 10
    found, _ = recurring(("mount", "arm"), tuple(kept(claims)), fits, kept(claims))
    assert [each.name for each in found] == ["arm"]
    assert abs(found[0].rivals["mount"]) < 1e-6


def test_a_flight_whose_model_cannot_have_it_is_not_told() -> None:
    fits = [each.fits() for each in fleet(5, 8, {"delay": [1.0] * 8})]
    for each in fits[:2]:
        each["effects"], each["sets"] = {}, {"": each["sets"][""]}
    found = recurrence_of_effect(fits, "delay", [NONE] * 8)
    six = recurrence_of_effect(fits[2:], "delay", [NONE] * 6)
    assert found is not None
    assert six is not None
    assert found.value == pytest.approx(six.value)
    assert found.probability[2:] == pytest.approx(six.probability)
    assert list(found.at_common[:2]) == [0.0, 0.0]
    assert recurrence_of_effect(fits[:3], "delay", [NONE] * 3) is None


def test_candidates_are_what_two_flights_name_and_one_claims() -> None:
    claims: list[dict[str, list[str]]] = [
        {"sensor-delay:q": ["sensor-lag:q"]},
        {"sensor-delay:q": []},
        {"vane-offset": ["sensor-lag:q"]},
        {"gust-discrete": []},
        {"gust-discrete": []},
    ]
    content = kept(claims)
    # a gust is of its flight, the arm is named once
    assert candidates(content) == ("sensor-delay:q", "sensor-lag:q")
    content["F004"]["effects"].append(
        {"name": "vane-offset", "claimed": False, "alternatives": [], "parameters": {}}
    )
    assert candidates(content) == ("sensor-delay:q", "sensor-lag:q", "vane-offset")
    assert candidates({}) == ()


def test_a_flights_own_effects_and_the_starts_of_shared_ones() -> None:
    content = kept(
        [
            {"gust-discrete": [], "sensor-delay:q": []},
            {"sensor-delay:q": []},
            {"sensor-lag:q": ["sensor-delay:q"]},
        ]
    )
    for number, flight in enumerate(content.values()):
        for each in flight["effects"]:
            each["parameters"] = {"delay": {"value": 0.1 * (number + 1), "unit": "s", "std": 0.01}}
    shared = ("sensor-delay:q",)
    assert effects_of_one_flight(content["F000"], shared) == {
        "gust-discrete": {"gust-discrete.delay": 0.1}
    }
    assert effects_of_one_flight(content["F002"], shared) == {
        "sensor-lag:q": {"sensor-lag:q.delay": pytest.approx(0.3)}
    }
    assert starts_of(content, shared) == {"sensor-delay:q.delay": pytest.approx(0.15)}
