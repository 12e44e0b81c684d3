"""Pseudo-true values: many draws flown at once against one by one, one fit to all of them against
other ways to the same values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exam.surrogates.declaration import MEASURED, Causes
from exam.surrogates.fitting import declared_model, estimated, fitted
from exam.surrogates.flights.drawing import SPEED, Dominant, Drawn, draw, hiding
from exam.surrogates.flights.flying import fly_drawn, fly_draws
from exam.surrogates.flights.many_flights import fly_side_by_side
from exam.surrogates.pseudo_true import fit_together, has_limit, pseudo_true
from scenarios.preparation.measured_inputs import with_flow
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.effects.disturbance.gusts import GustTurbulence
from sim.effects.library import find_effect
from sim.errors import ModelError
from sim.maneuvers import doublet, three_two_one_one
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import rigid_model
from sim.vehicles.library import read_parameter_set
from tests.surrogates import ALL_CHANNELS, CALM, EVERY, short

HIDDEN = {
    "sensor-delay:q": {"delay": 0.08},
    "input-backlash": {"half_width": 0.005},
    "gust-turbulence": {"sigma": 1.0},
    "elastic-mode": {"lift": 0.1, "moment": -0.1, "frequency": 12.0, "damping": 0.03},
    SPEED: {"rate": 0.5},
}


def plan(causes: Causes = EVERY) -> Drawn:
    return draw(short(causes, step=0.02), np.random.default_rng(5))


def with_hidden(drawn: Drawn, *names: str, records: tuple[int, ...] = (0, 1)) -> Drawn:
    effects = tuple(
        Dominant(find_effect(name, drawn.model.equations), HIDDEN[name], records) for name in names
    )
    return hiding(drawn, effects)


@pytest.mark.sampled
@pytest.mark.parametrize("name", HIDDEN)
@pytest.mark.parametrize("records", [(0, 1), (1,)])
def test_flights_flown_at_once_are_those_flown_one_by_one(
    name: str, records: tuple[int, ...]
) -> None:
    drawn = with_hidden(plan(), name, records=records)
    at_once = fly_draws(drawn, np.random.default_rng(6).spawn(2), ALL_CHANNELS)
    for generator, flown in zip(np.random.default_rng(6).spawn(2), at_once, strict=True):
        for one, same in zip(
            (each.record for each in fly_drawn(drawn, generator, noise=False)), flown, strict=True
        ):
            assert (one.name, one.hold, one.output_names) == (
                same.name,
                same.hold,
                same.output_names,
            )
            assert np.array_equal(one["elevator"].values, same["elevator"].values)
            for channel in one.outputs:
                size = float(np.max(np.abs(channel.values)))
                assert np.allclose(
                    channel.values, same[channel.name].values, rtol=0.0, atol=1e-9 * size
                ), channel.name


def test_only_some_records_and_channels_are_flown() -> None:
    drawn = plan()
    whole, part = (
        fly_draws(drawn, np.random.default_rng(6).spawn(2), names, count=n)
        for names, n in ((ALL_CHANNELS, None), (MEASURED, 1))
    )
    for all_of_it, first in zip(whole, part, strict=True):
        assert len(first) == 1 and first[0].output_names == MEASURED
        assert all(
            np.allclose(first[0][name].values, all_of_it[0][name].values, rtol=0.0, atol=1e-12)
            for name in MEASURED
        )


def test_what_cannot_fly_side_by_side_is_refused() -> None:
    model = plan(CALM).declared.with_effects(
        find_effect("input-delay", plan(CALM).declared.equations)
    )
    time, moves = sample_times(25.0, 2.0), {"elevator": [doublet(0.02, 0.5)] * 2}
    with pytest.raises(ModelError, match="one by one"):
        fly_side_by_side(model, {"input-delay.delay": np.array([0.1, 0.2])}, moves, time)
    with pytest.raises(ModelError, match="diverges"):
        fly_side_by_side(model, {"Cm_alpha": np.array([-1.0, 1e6])}, moves, time, step=0.01)
    both = fly_side_by_side(model, {"Cm_alpha": np.array([-1.0, -0.5])}, moves, time, step=0.01)
    alone, _ = fly(
        model.with_values({"Cm_alpha": -0.5}),
        moves["elevator"][0],
        time,
        np.random.default_rng(0),
        step=0.01,
    )
    assert np.allclose(both["q"][:, 1], alone["q"].values, rtol=0.0, atol=1e-12)


def carrying(
    drawn: Drawn, effects: tuple[Dominant, ...], draws: int, seed: int
) -> tuple[Model, list[list[Record]]]:
    """The model to be fitted, at nominal derivatives, and all draws' records."""
    nominal = {name: drawn.declared.parameters[name].value for name in drawn.starts}
    model = declared_model(
        drawn.declared, nominal, [(each.effect, each.values) for each in effects]
    )
    flown = fly_draws(
        drawn, np.random.default_rng(seed).spawn(draws), (*MEASURED, "airspeed", "dynamic_pressure")
    )
    found = [with_flow(model, records) for records in flown]
    return found[0][0], [records for _, records in found]


@pytest.mark.sampled
@pytest.mark.parametrize("names", [(), ("sensor-delay:q",), ("elastic-mode",)])
def test_one_fit_to_all_draws_is_that_of_levenberg_and_marquardt(names: tuple[str, ...]) -> None:
    """The general fit, which holds every record's sensitivities and damps every step, ends at the
    same values.
    """
    drawn = with_hidden(plan(), *names)
    model, draws = carrying(drawn, drawn.hidden, 3, 8)
    joint = fit_together(
        [[record.only(MEASURED) for record in records] for records in draws],
        compile_model(model, MEASURED),
    )
    wanted = estimated(fitted([record for records in draws for record in records], model))
    assert joint.settled and joint.names == wanted.names
    assert np.all(
        np.abs(joint.point.shared - wanted.values)
        < np.maximum(0.2 * wanted.std, 0.05 * np.sqrt(np.diag(joint.covariance)))
    )


def test_a_model_that_lacks_nothing_has_its_nominal_values() -> None:
    """Samples as close as the table of the maneuver: nothing is lost between them."""
    drawn = draw(short(rates=(200.0,), step=0.005), np.random.default_rng(5))
    found = pseudo_true(
        drawn,
        {},
        3,
        np.random.default_rng(1),
        starts={name: 1.2 * value for name, value in drawn.starts.items()},
    )
    for name, value in found.nominal.items():
        assert found.values[name] == pytest.approx(value, rel=1e-6), name
        assert found.std[name] < 1e-6 * abs(value)


@pytest.mark.long
@pytest.mark.parametrize("names", [(), ("sensor-delay:q",)])
def test_draws_fitted_one_by_one_and_joined_give_the_same_within_their_scatter(
    names: tuple[str, ...],
) -> None:
    drawn = with_hidden(plan(), *names)
    found = pseudo_true(drawn, {name: {} for name in names}, 6, np.random.default_rng(8))
    model, draws = carrying(drawn, drawn.hidden, 6, 8)
    estimates = [estimated(fitted(records, model)) for records in draws]
    weights = [np.linalg.inv(each.covariance) for each in estimates]
    joined = np.linalg.solve(
        np.sum(weights, axis=0),
        np.sum([w @ each.values for w, each in zip(weights, estimates, strict=True)], axis=0),
    )
    std = np.std([each.values for each in estimates], axis=0, ddof=1) / np.sqrt(6)
    assert np.all(
        np.abs(np.array([found.values[name] for name in estimates[0].names]) - joined) < std
    )


@pytest.mark.long
def test_where_the_fit_starts_does_not_matter() -> None:
    drawn = plan(replace(EVERY, turbulence=0.05))
    first = pseudo_true(drawn, {}, 4, np.random.default_rng(8))
    other = pseudo_true(
        drawn,
        {},
        4,
        np.random.default_rng(8),
        starts={name: 0.7 * value for name, value in first.nominal.items()},
    )
    for name, value in first.values.items():
        assert abs(other.values[name] - value) < 0.1 * first.std[name], name


@pytest.mark.parametrize(
    ("claimed", "known"),
    [
        ((), True),
        (("sensor-delay:q", "moment-nonlinearity", "sensor-spikes:q"), True),
        (("gust-turbulence",), False),
        (("sensor-delay:q", "phugoid"), False),
        (("speed-variation",), False),
    ],
)
def test_flights_tend_to_no_value_where_what_belongs_to_one_record_was_fitted(
    claimed: tuple[str, ...], known: bool
) -> None:
    assert has_limit(plan(), claimed) is known


def test_turbulence_that_is_hidden_in_every_record_has_no_limit_either() -> None:
    drawn = plan()
    rough = hiding(
        drawn,
        (
            Dominant(
                GustTurbulence(),
                {"sigma": 1.5, "length": 250.0},
                tuple(range(len(drawn.maneuvers))),
            ),
        ),
    )
    assert not has_limit(rough, ["gust-turbulence"]) and has_limit(rough, [])


@pytest.mark.slow
def test_standard_errors_are_the_scatter_of_repetitions() -> None:
    """Thirty repetitions of ten draws: a scatter known to an eighth, sigmas of ten draws biased low
    by a few percent.
    """
    drawn = with_hidden(plan(), "sensor-delay:q")
    found = [
        pseudo_true(drawn, {"sensor-delay:q": {}}, 10, generator)
        for generator in np.random.default_rng(9).spawn(30)
    ]
    for name in found[0].values:
        scatter = float(np.std([each.values[name] for each in found], ddof=1))
        said = float(np.sqrt(np.mean([each.std[name] ** 2 for each in found])))
        assert 0.65 < said / scatter < 1.5, (name, said / scatter)


def test_flights_side_by_side_refuse_random_forcing_however_weak() -> None:
    forced = rigid_model(read_parameter_set("bomber_rigid"), Noise({}, {"q": 1e-6}))
    assert (
        compile_model(forced).noise(compile_model(forced).parameters.values().tolist())[0][1]
        == 1e-6
    )
    with pytest.raises(ModelError, match="random forcing"):
        fly_side_by_side(
            forced, {}, {"elevator": [three_two_one_one(0.1, 0.5, 1.0)]}, sample_times(50.0, 1.0)
        )
