"""What is hidden by the campaign of every effect: kinds, values, and how strong they are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from exam.every_effect import flight
from exam.every_effect.carriers import (
    MODELS,
    UNSEEN,
    Instance,
    chosen,
    drawn_carrier,
    effect_of,
    equations_of,
    library_kinds,
)
from exam.every_effect.flight import (
    FAR,
    LARGEST,
    STRONGEST,
    WEAKEST,
    Scale,
    amount_for,
    drawn,
    fly_hidden,
)
from exam.scores.rates import NOTHING, kind_of
from sim.declaration.effect import full_name
from sim.declaration.model import Noise
from sim.declaration.proposal import SearchContext, Traceable
from sim.effects.library import effects_for, library
from sim.errors import DeclarationError
from sim.truth.flight import fly


def test_every_effect_that_may_be_proposed_is_hidden_on_each_model_that_has_it() -> None:
    hidden = {
        (each.model, each.name) for kind in library_kinds().values() for each in kind if each.name
    }
    for model in MODELS:
        offered = {
            each.name
            for each in effects_for(equations_of(model))
            if isinstance(each, Traceable) and not each.traits.general
        }
        assert {name for where, name in hidden if where == model} == offered - {*UNSEEN}
    assert {
        kind_of(each.name)
        for each in library()
        if isinstance(each, Traceable) and not each.traits.general
    } - {"missing-term"} == {*library_kinds()} - {NOTHING}, "terms are the model aircraft's"
    assert {each.model for each in library_kinds()[NOTHING]} == {*MODELS}
    fall = SearchContext(
        0.0, 30.0, 0.1, state_peak={"altitude": 6e4}, flown={"velocity": (-1800.0, -300.0)}
    )
    searched = {
        each.name
        for each in effects_for(equations_of("ballistic"))
        if isinstance(each, Traceable) and each.probes(fall)
    }
    assert not searched & {*UNSEEN} and "sensor-scale:altitude" in searched


def test_kinds_and_full_names_may_be_asked_for_and_others_are_refused() -> None:
    found = chosen(["nothing", "sensor-lag:q", "vane-offset"])
    assert [*found] == ["nothing", "sensor-lag:q", "vane-offset"]
    assert {each.name for each in found["sensor-lag:q"]} == {"sensor-lag:q"} and {
        each.name for each in found["vane-offset"]
    } == {"vane-offset"}
    with pytest.raises(
        DeclarationError, match="there is no effect 'vane-ofset'; did you mean 'vane-offset'"
    ):
        chosen(["vane-ofset"])
    with pytest.raises(DeclarationError, match="vane-offset is named twice"):
        chosen(["vane-offset", "vane-offset"])
    with pytest.raises(DeclarationError, match="no effect is named"):
        chosen([])


STRONG = 3  # a seed from which a strong effect is drawn
CARRIERS = {model: drawn_carrier(model, np.random.default_rng(3)) for model in MODELS}
INSTANCES = [each for kind in library_kinds().values() for each in kind if each.name]


@pytest.mark.parametrize("instance", INSTANCES, ids=lambda each: f"{each.name} {each.model}")
def test_values_are_within_bounds_and_vanish_with_their_amount(instance: Instance) -> None:
    effect, carrier = effect_of(instance), CARRIERS[instance.model]
    draw = drawn(effect, carrier.train, np.random.default_rng(5))
    items = {item.name: item for item in effect.parameters}
    assert {*draw.at(1.0)} == {*items}
    for amount in (0.01, 1.0, LARGEST):
        assert all(
            items[local].bounds[0] <= value <= items[local].bounds[1]
            for local, value in draw.at(amount).items()
        )
    for local, gone in draw.absent.items():
        assert draw.at(0.0)[local] == gone
        near, far = draw.at(1e-9)[local], draw.at(1.0)[local]
        assert near == gone or (
            abs(near - gone) < 1e-6 * abs(far - gone)
            if abs(gone) < FAR
            else abs(near) > 1e6 * abs(far)
        )
    if effect.traits.onset:
        assert (
            0.1 * carrier.train.duration
            < draw.at(1.0)[effect.traits.onset]
            < 0.7 * carrier.train.duration
        )


def test_the_amount_that_is_as_strong_as_wanted_is_found_and_else_the_strongest() -> None:
    for law in (
        lambda x: 10.0 * x,
        lambda x: 3.0 * x**2,
        lambda x: 40.0 * math.sqrt(x),
        lambda x: math.inf if x > 0.4 else 50.0 * x,
    ):
        amount, length = amount_for(law, 17.0)
        assert length == law(amount) == pytest.approx(17.0, rel=0.051)
    assert amount_for(lambda x: min(x, 2.0), 17.0)[1] == 2.0
    assert amount_for(lambda x: math.inf if x > 0.1 else 50.0 * x, 17.0)[1] == pytest.approx(
        5.0, rel=0.1
    )


def test_strength_is_what_least_squares_of_the_declared_model_leaves() -> None:
    """Written again: the change of the outputs by a vane's arm, fitted by slopes over central
    differences of whole flights.
    """
    carrier = CARRIERS["rigid"]
    effect = effect_of(Instance("rigid", "vane-offset"))
    plan = carrier.train

    def outputs(model) -> np.ndarray:
        record, _ = fly(
            model.with_noise(Noise()),
            plan.inputs,
            plan.time,
            np.random.default_rng(0),
            step=0.005,
            outputs=["alpha", "q", "nz"],
        )
        return np.concatenate(
            [record[name].values / carrier.noise[name] for name in ("alpha", "q", "nz")]
        )

    base = outputs(plan.model)
    change = (
        outputs(plan.model.with_effects(effect).with_values({full_name(effect, "arm"): 4.0})) - base
    )
    columns = []
    for name in carrier.free:
        value = plan.model.parameters[name].value
        up, down = (
            outputs(plan.model.with_values({name: value * (1.0 + step)})) for step in (1e-3, -1e-3)
        )
        columns.append((up - down) / 2e-3)
    for item in plan.model.initial:
        up, down = (
            outputs(
                plan.model.with_initial(
                    plan.model.initial.with_values({item.name: item.value + step})
                )
            )
            for step in (1e-3, -1e-3)
        )
        columns.append((up - down) / 2e-3)
    ones = np.zeros((3, len(plan.time)))
    for row in range(3):
        ones[row] = 1.0
        columns.append(ones.ravel().copy())
        ones[row] = 0.0
    matrix = np.array(columns).T
    normal = matrix.T @ matrix
    scale = np.sqrt(np.diag(normal))
    fitted = matrix @ (
        np.linalg.solve(normal / np.outer(scale, scale), (matrix.T @ change) / scale) / scale
    )
    assert Scale(carrier, 1).length(((effect, {"arm": 4.0}),)) == pytest.approx(
        float(np.sqrt(np.sum((change - fitted) ** 2))), rel=0.02
    )


def test_a_seed_flies_the_same_twice_and_another_one_differently() -> None:
    one, two, other = (
        fly_hidden(library_kinds()["density-scale-height"], 0, seed) for seed in (7, 7, 8)
    )
    assert (
        one.values == two.values != other.values
        and one.carrier.vehicle_file == two.carrier.vehicle_file
    )
    assert all(
        a.values.tobytes() == b.values.tobytes()
        for a, b in zip(one.train.outputs, two.train.outputs, strict=True)
    )
    assert 0.5 * WEAKEST < one.size < 1.1 * STRONGEST


def test_where_an_effect_cannot_be_seen_another_of_its_kind_is_flown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    weak, strong = (
        Instance("ballistic", name) for name in ("density-scale-height", "sensor-scale:altitude")
    )
    made = {each: flight._attempt(each, 20.0, np.random.default_rng(1)) for each in (weak, strong)}
    tried: list[Instance] = []

    def attempt(instance: Instance, wanted: float, rng: np.random.Generator) -> Any:
        tried.append(instance)
        return *made[instance][:3], 1.0 if instance is weak else 100.0

    monkeypatch.setattr(flight, "_attempt", attempt)
    assert flight.fly_hidden([weak, strong], 0, STRONG).name == strong.name
    assert tried[0] is weak and tried[-1] is strong and strong not in tried[:-1]
    assert flight.fly_hidden([weak], 0, STRONG).name == weak.name


def test_nothing_is_hidden_where_nothing_is_asked_for() -> None:
    clean = fly_hidden([Instance("ballistic", "")], 0, 3)
    assert (clean.name, dict(clean.values), clean.size) == ("", {}, 0.0)
