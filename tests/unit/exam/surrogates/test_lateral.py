"""Surrogate flights of the lateral axis: nothing on is the plain flight, every level and every
hidden effect shows, files hold no truth.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exam.surrogates.declaration import LATERAL, Causes, FlightLine, Hidden, Surrogate
from exam.surrogates.flights.dominant import draw_dominant
from exam.surrogates.flights.drawing import Dominant, Drawn, hiding
from exam.surrogates.flights.flight import fly_surrogate, write_flight
from exam.surrogates.flights.flying import fly_drawn, fly_draws
from exam.surrogates.flights.lateral.drawing import LATERAL_KINDS, PAIRS, draw_lateral, dutch_roll
from exam.surrogates.pseudo_true import pseudo_true
from exam.surrogates.schema import load_surrogate, surrogate_names
from exam.surrogates.study import acts
from sim.declaration.effect import Station
from sim.effects.library import effects_for, find_effect
from sim.errors import DeclarationError
from sim.propagation import rk4_step
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import linearise
from sim.vehicles.uncoupled import Lateral
from tests.surrogates import CALM, DEGREE, EVERY, NOTHING

MEASURED = tuple(signal.name for signal in Lateral().outputs)
LEVELS = replace(EVERY, noise_std=dict.fromkeys(MEASURED, 0.001))


def short(causes: Causes = CALM, hidden: Hidden = NOTHING, **changes: Any) -> Surrogate:
    line = {
        "vehicles": ("navion_lateral",),
        "variation": 0.2,
        "records": (1, 1),
        "duration": 8.0,
        "rates": (25.0,),
        "step": 0.02,
    }
    more = {
        "maneuvers": ("3-2-1-1", "hand-flown"),
        "amplitude": (2.0 * DEGREE, 3.0 * DEGREE),
        "axis": LATERAL,
    }
    return Surrogate(
        "short", "short", "", FlightLine(**{**line, **more, **changes}), causes, hidden, draws=0
    )


def drawn(causes: Causes = CALM, **changes: Any) -> Drawn:
    return draw_lateral(short(causes, **changes), np.random.default_rng(5))


def records(plan: Drawn, *, noise: bool = False) -> list[Record]:
    return [flown.record for flown in fly_drawn(plan, np.random.default_rng(6), noise=noise)]


def test_with_nothing_on_a_record_is_the_plain_flight() -> None:
    plan = drawn(records=(2, 2), step=0.01)
    for number, record in enumerate(records(plan)):
        moves = {name: plan.moves(name)[number] for name in ("rudder", "aileron")}
        plain, _ = fly(
            plan.declared,
            moves,
            sample_times(25.0, 8.0),
            np.random.default_rng(0),
            step=0.01,
            method=rk4_step,
        )
        for name in MEASURED:
            np.testing.assert_allclose(
                record[name].values, plain[name].values, rtol=0.0, atol=1e-15, err_msg=name
            )
        assert (
            np.ptp(record["beta"].values) > 1.0 * DEGREE
            and np.ptp(record["p"].values) > 2.0 * DEGREE
        )


@pytest.mark.sampled
@pytest.mark.parametrize(
    "level",
    [
        item.name
        for item in fields(Causes)
        if item.name
        not in ("noise_std", "noise_time", "trim_lift", "downwash_lag", "turbulence_length")
    ],
)
def test_every_level_changes_the_records(level: str) -> None:
    if level in ("anti_alias_spread", "anti_alias_odd"):
        before, after = replace(LEVELS, anti_alias_spread=0.0), LEVELS
    else:
        before, after = CALM, replace(CALM, **{level: getattr(LEVELS, level)})
    plain, changed = records(drawn(before)), records(drawn(after))
    most = max(
        float(np.max(np.abs(a[c.name].values - c.values)))
        for a, b in zip(changed, plain, strict=True)
        for c in b.channels
    )
    assert 1e-6 < most < 0.1, level


# A few always, all of them with the slow ones.
ALWAYS = (
    "input-delay:rudder",
    "input-backlash:aileron",
    "elastic-mode",
    "vane-offset",
    "gust-discrete",
)
EACH = [
    pytest.param(name, marks=() if name in ALWAYS else pytest.mark.slow) for name in LATERAL_KINDS
]


@pytest.mark.sampled
@pytest.mark.parametrize("name", EACH)
def test_every_hidden_effect_shows_and_vanishes_with_its_size(name: str) -> None:
    plan = drawn()
    plain, at = records(plan), LATERAL_KINDS[name](plan, np.random.default_rng(1))
    effect = find_effect(name, plan.model.equations)

    def change(size: float) -> float:
        changed = records(hiding(plan, (Dominant(effect, at(size), (0,)),)))
        pairs = [
            (a[c].values, b[c].values)
            for a, b in zip(changed, plain, strict=True)
            for c in MEASURED
        ]
        return max(float(np.max(np.abs(a - b)) / np.ptp(b)) for a, b in pairs)

    assert change(0.7) > 0.01
    assert change(1e-9) < (1.5e-3 if effect.station is Station.INPUT_PATH else 1e-5)


def test_what_can_be_hidden_is_in_the_library() -> None:
    assert set(LATERAL_KINDS) <= {effect.name for effect in effects_for(Lateral())}
    assert (
        acts("yaw-nonlinearity", LEVELS)
        and not acts("yaw-nonlinearity", CALM)
        and not acts("input-delay:rudder", LEVELS)
    )


@pytest.mark.parametrize("kind", list(PAIRS))
def test_a_pair_moves_both_surfaces_and_lets_them_rest(kind: str) -> None:
    plan = drawn(maneuvers=(kind,), duration=30.0)
    for name in ("rudder", "aileron"):
        move = plan.moves(name)[0]
        assert np.max(np.abs(move.values)) > 0.5 * DEGREE
        assert np.all(move.values[: round(0.9 / move.spacing)] == 0.0), "quiet at the start"


def test_the_dutch_roll_is_the_oscillating_root() -> None:
    plan = drawn()
    roots = np.linalg.eigvals(linearise(plan.declared).A)
    pair = roots[np.abs(roots.imag) > 0.1]
    assert len(pair) == 2 and dutch_roll(plan.declared) == pytest.approx(abs(pair[0]))


def test_the_files_hold_no_truth(tmp_path: Path) -> None:
    flight = fly_surrogate(short(LEVELS), 2)
    paths, vehicle = write_flight(flight, tmp_path)
    for path in paths:
        assert set(path.read_text().splitlines()[0].split(",")) == {
            "time",
            "rudder",
            "aileron",
            *MEASURED,
        }
    for name, value in flight.drawn.starts.items():
        assert 0.05 <= abs(value / flight.drawn.declared.parameters[name].value - 1.0) <= 0.3
        assert f"{name} = {float(value)!r}\n" in vehicle.read_text()


@pytest.mark.slow
def test_the_dominant_effect_is_drawn_by_name_and_size() -> None:
    asked = short(LEVELS, Hidden(1, ("sensor-delay:r",)), records=(2, 2), duration=10.0)
    (found,) = draw_dominant(
        draw_lateral(asked, np.random.default_rng(5)), np.random.default_rng(1)
    ).hidden
    assert (
        found.name == "sensor-delay:r"
        and 0.02 < found.values["delay"] < 0.3
        and found.records == (0, 1)
    )


def test_nothing_is_hidden_that_is_not_asked_for_or_is_of_the_other_axis() -> None:
    assert draw_dominant(drawn(), np.random.default_rng(1)).hidden == ()
    with pytest.raises(DeclarationError, match="'input-delay' cannot be hidden"):
        draw_dominant(
            draw_lateral(short(CALM, Hidden(1, ("input-delay",))), np.random.default_rng(5)),
            np.random.default_rng(1),
        )


@pytest.mark.parametrize("name", [name for name in surrogate_names() if "lateral" in name])
def test_the_catalogue(name: str) -> None:
    surrogate, other = load_surrogate(name), load_surrogate("surrogate-lateral")
    assert (
        surrogate.flight.axis == LATERAL
        and surrogate.causes == other.causes
        and set(surrogate.causes.noise_std) == set(MEASURED)
    )
    assert (surrogate.hidden.count == 0) == name.endswith("none") and set(
        surrogate.hidden.names
    ) <= set(LATERAL_KINDS)


@pytest.mark.long
@pytest.mark.parametrize("hidden", ["sensor-delay:r", "gust-turbulence"])
def test_flights_flown_at_once_are_those_flown_one_by_one(hidden: str) -> None:
    plan = drawn(LEVELS, records=(2, 2), duration=4.0)
    effect = find_effect(hidden, plan.model.equations)
    plan = hiding(
        plan, (Dominant(effect, {"delay": 0.08} if ":" in hidden else {"sigma": 1.0}, (1,)),)
    )
    at_once = fly_draws(plan, np.random.default_rng(6).spawn(2), MEASURED)
    for generator, flown in zip(np.random.default_rng(6).spawn(2), at_once, strict=True):
        for one, same in zip(
            (each.record for each in fly_drawn(plan, generator, noise=False)), flown, strict=True
        ):
            assert (one.name, one.hold, one.output_names) == (
                same.name,
                same.hold,
                same.output_names,
            )
            for channel in one.channels:
                np.testing.assert_allclose(
                    same[channel.name].values,
                    channel.values,
                    rtol=0.0,
                    atol=1e-12,
                    err_msg=channel.name,
                )


@pytest.mark.long
def test_pseudo_true_values_are_the_nominal_ones_without_small_causes_and_not_with_them() -> None:
    calm, curved = (
        drawn(replace(CALM, moment_curvature=level), records=(2, 2), duration=10.0, step=0.01)
        for level in (0.0, 0.2)
    )
    found, moved = (pseudo_true(plan, {}, 2, np.random.default_rng(1)) for plan in (calm, curved))
    assert set(found.values) >= set(calm.starts)
    # Surfaces that are straight between samples cost 0.3 %; a derivative near zero is as well known
    # as the others.
    assert (
        max(
            abs(found.values[name] - value) / max(abs(value), 0.05)
            for name, value in found.nominal.items()
        )
        < 5e-3
    )
    assert max(abs(moved.bias(name)) for name in calm.starts) > 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("flight.axis=sideways", "there is no axis 'sideways'"),
        ("flight.vehicles=['fighter']", "there is no vehicle 'fighter'"),
        ("flight.maneuvers=['step']", "there is no maneuver 'step'"),
        ("causes.noise_std.alpha=0.1", "there is no channel 'alpha'"),
        (
            "hidden.names=['input-delay']",
            "there is no effect that can be hidden here 'input-delay'",
        ),
        ("flight.unrecorded=['theta']", "there is no further channel 'theta'; leave it out"),
        ("flight.level=true", "key flight.level: this is for the longitudinal axis; leave it out"),
        ("flight.once='step'", "there is no maneuver 'step'"),
        ("flight.once='mixed'", "key flight.once: this is for the longitudinal axis; leave it out"),
        (
            "flight.optional=0.5",
            "key flight.optional: this is for the longitudinal axis; leave it out",
        ),
    ],
)
def test_what_is_wrong_is_named(change: str, message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        load_surrogate("surrogate-lateral", [change])
