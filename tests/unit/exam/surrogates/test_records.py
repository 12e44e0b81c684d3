"""Laws of the surrogate flights' records: same seed same bytes, nothing on is the plain flight,
every level and every hidden effect shows.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exam.surrogates.declaration import MEASURED, OPTIONAL, Causes, Hidden
from exam.surrogates.fitting import declared_model, left_over, misfit
from exam.surrogates.flights.dominant import LEAST, group, sized
from exam.surrogates.flights.drawing import Dominant, Drawn, draw, hiding
from exam.surrogates.flights.flight import fly_surrogate, write_flight
from exam.surrogates.flights.flying import fly_drawn
from exam.surrogates.flights.kinds import KINDS
from exam.surrogates.schema import load_surrogate, surrogate_names
from sim.declaration.effect import Station
from sim.effects.library import effect_names, find_effect
from sim.errors import DeclarationError
from sim.propagation import rk4_step
from sim.record import Hold, Record
from sim.truth.flight import fly, sample_times
from tests.surrogates import ALL_CHANNELS, CALM, EVERY, short

LATERAL = ("surrogate-lateral", "surrogate-lateral-none")
NAMES = tuple(name for name in surrogate_names() if name not in LATERAL)


def drawn(causes: Causes = CALM, **changes: Any) -> Drawn:
    return draw(short(causes, **changes), np.random.default_rng(5))


def records(plan: Drawn, *, noise: bool = True, count: int | None = None) -> list[Record]:
    return [
        flown.record
        for flown in fly_drawn(plan, np.random.default_rng(6), noise=noise, count=count)
    ]


def values(record: Record) -> np.ndarray:
    return np.array([channel.values for channel in record.channels])


@pytest.mark.long
def test_same_seed_same_bytes(tmp_path: Path) -> None:
    surrogate, written = short(EVERY), []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        paths, vehicle = write_flight(fly_surrogate(surrogate, 4), tmp_path / name)
        written.append([path.read_bytes() for path in (*paths, vehicle)])
    assert written[0] == written[1]
    other = fly_surrogate(surrogate, 5).records
    assert not np.allclose(values(other[0])[:4], values(fly_surrogate(surrogate, 4).records[0])[:4])


def test_with_nothing_on_a_record_is_the_plain_flight_bit_for_bit() -> None:
    plan = drawn(total=False, trim_alpha=(0.0, 0.0))
    for record, move in zip(records(plan), plan.maneuvers, strict=True):
        time = sample_times(25.0, 8.0)
        plain, _ = fly(
            plan.declared, move, time, np.random.default_rng(0), step=0.01, method=rk4_step
        )
        for name in MEASURED:
            assert np.array_equal(record[name].values, plain[name].values), name
        assert np.array_equal(record["elevator"].values, move(time))
        assert record.hold is Hold.LINEAR
        assert np.all(record["airspeed"].values == plan.declared.parameters["airspeed"].value)


# What a level needs beside it to show, and the channel in which it must.
LEVELS: dict[str, tuple[dict[str, object], str]] = {
    "anti_alias": ({"anti_alias": 7.0}, "q"),
    "anti_alias_spread": (
        {"anti_alias": 7.0, "anti_alias_odd": 1.0, "anti_alias_spread": 0.05},
        "q",
    ),
    "anti_alias_odd": ({"anti_alias": 7.0, "anti_alias_spread": 0.2, "anti_alias_odd": 1.0}, "nz"),
    "input_noise": ({"input_noise": 0.001}, "elevator"),
    "turbulence": ({"turbulence": 0.2}, "alpha"),
    "turbulence_length": ({"turbulence": 0.2, "turbulence_length": 100.0}, "alpha"),
    "speed_drift": ({"speed_drift": 0.02}, "airspeed"),
    "gravity": ({"gravity": 1.0}, "airspeed"),
    "trim_lift": ({"gravity": 1.0, "trim_lift": 1.0}, "nz"),
    "downwash": ({"downwash": 0.3}, "q"),
    "downwash_lag": ({"downwash": 0.3, "downwash_lag": 0.2}, "q"),
    "elastic": ({"elastic": 0.02}, "q"),
    "moment_curvature": ({"moment_curvature": 0.05}, "q"),
    "lift_curvature": ({"lift_curvature": 0.05}, "nz"),
    "mass_scatter": ({"mass_scatter": 0.02}, "nz"),
    "inertia_scatter": ({"inertia_scatter": 0.02}, "q"),
    "airspeed_scatter": ({"airspeed_scatter": 0.02}, "airspeed"),
    "density_scatter": ({"density_scatter": 0.02}, "dynamic_pressure"),
    "trim_scatter": ({"trim_scatter": 0.005}, "theta"),
    "noise_std": ({"noise_std": {"q": 0.001}}, "q"),
    "noise_time": ({"noise_std": {"q": 0.001}, "noise_time": 0.5}, "q"),
}


def test_every_level_has_its_law() -> None:
    assert set(LEVELS) == {item.name for item in fields(Causes)}


@pytest.mark.sampled
@pytest.mark.parametrize("name", LEVELS)
def test_each_level_shows_by_itself(name: str) -> None:
    levels, channel = LEVELS[name]
    usual = {item.name: getattr(CALM, item.name) for item in fields(Causes)}
    on, off = replace(CALM, **levels), replace(CALM, **{**levels, name: usual[name]})  # type: ignore[arg-type]
    first, second = (records(drawn(causes), count=1)[0] for causes in (on, off))
    difference = np.abs(first[channel].values - second[channel].values)
    assert float(difference.max()) > 1e-3 * float(
        np.ptp(second[channel].values) or abs(second[channel].values).max()
    )


@pytest.mark.long
def test_what_is_left_resembles_a_measured_flight() -> None:
    """Residuals that remember, and scatter several times what white residuals promise: as flight
    data show, and white noise does not.
    """
    surrogate = load_surrogate(
        "surrogate-none",
        (
            "flight.records=[4,4]",
            "flight.step=0.02",
            "flight.rates=[25]",
            "flight.vehicles=['fighter']",
        ),
    )
    flight = fly_surrogate(surrogate, 3)
    rest = left_over(
        flight.records,
        declared_model(flight.drawn.declared, flight.drawn.starts),
        surrogate.causes.noise_std,
    )
    assert np.all((rest["correlation"] > 0.6) & (rest["correlation"] < 0.99))
    assert np.all(rest["excess"] > 1.1)
    assert 2.0 < float(np.median(rest["inflation"])) < 15.0


@pytest.mark.sampled
@pytest.mark.parametrize("name", KINDS)
def test_every_hidden_effect_shows_and_vanishes_with_its_size(name: str) -> None:
    plan = drawn(step=0.02)
    plain, at = records(plan, noise=False), KINDS[name](plan, np.random.default_rng(1))
    effect = find_effect(name, plan.model.equations)

    def change(size: float) -> float:
        changed = records(hiding(plan, (Dominant(effect, at(size), (0, 1)),)), noise=False)
        return max(
            float(np.max(np.abs(a[c].values - b[c].values) / np.ptp(b[c].values)))
            for a, b in zip(changed, plain, strict=True)
            for c in MEASURED
        )

    assert change(0.7) > 0.01
    # An input path carries means over cells instead of the straight input, a rate limit steps from
    # cell to cell: up to a millisecond.
    assert change(1e-9) < (1.5e-3 if effect.station is Station.INPUT_PATH else 1e-5)


def test_the_names_that_can_be_hidden_are_those_of_the_library() -> None:
    assert {name.partition(":")[0] for name in KINDS} <= {
        name.partition(":")[0] for name in effect_names()
    }
    assert group("sensor-lag:alpha") == group("vane-offset") != group("sensor-lag:q")


@pytest.mark.long
def test_a_hidden_effect_is_as_large_as_asked() -> None:
    plan = drawn(EVERY, duration=10.0)
    model, seed = declared_model(plan.declared, plan.starts), 11

    def errors(hidden: tuple[Dominant, ...]) -> np.ndarray:
        flown = fly_drawn(hiding(plan, hidden), np.random.default_rng(seed), step=0.01)
        return misfit([one.record for one in flown], model)

    found = sized(plan, "input-delay", 0.5, errors(()), seed, np.random.default_rng(2))
    assert found is not None
    reduction = 1.0 - float(np.min(errors(()) / errors((found,))))
    assert LEAST < reduction < 0.65
    # A curve of the control bends over the range that the control moves through.
    curve: Any = sized(
        plan, "control-nonlinearity", 0.5, errors(()), seed, np.random.default_rng(2)
    )
    assert curve is not None and 0.0 < curve.effect.high == -curve.effect.low


def test_an_event_belongs_to_one_record() -> None:
    plan = drawn()
    event = Dominant(
        find_effect("unmeasured-input", plan.model.equations),
        {"start": 3.0, "duration": 1.0, "moment": 0.01, "lift": 0.0},
        (1,),
    )
    before, after = records(plan), records(hiding(plan, (event,)))
    assert np.array_equal(values(before[0]), values(after[0]))
    assert not np.allclose(before[1]["q"].values, after[1]["q"].values)


def test_more_effects_than_make_a_difference_are_refused() -> None:
    surrogate = short(EVERY, Hidden(2, ("sensor-lag:q", "sensor-delay:q")))
    with pytest.raises(DeclarationError, match="1 of 2 effects"):
        fly_surrogate(surrogate, 1)


@pytest.mark.parametrize("name", NAMES)
def test_the_catalogue(name: str) -> None:
    surrogate = load_surrogate(name)
    assert surrogate.title and surrogate.about and set(surrogate.hidden.names) <= set(KINDS)
    assert (surrogate.hidden.count == 0) == (name == "surrogate-none")
    assert set(surrogate.causes.noise_std) == set(ALL_CHANNELS)
    assert surrogate.flight.step < 0.01  # finer than the loop's
    # One level for all of them: what differs is what dominates.
    assert surrogate.causes == load_surrogate(NAMES[0]).causes


def test_the_files_hold_no_truth(tmp_path: Path) -> None:
    flight = fly_surrogate(short(EVERY), 2)
    paths, vehicle = write_flight(flight, tmp_path)
    for path in paths:
        assert set(path.read_text().splitlines()[0].split(",")) == {
            "time",
            "elevator",
            *MEASURED,
            *OPTIONAL,
        }
    for name, value in flight.drawn.starts.items():
        wrong = abs(value / flight.drawn.declared.parameters[name].value - 1.0)
        assert 0.05 <= wrong <= 0.3
        assert f"{name} = {float(value)!r}\n" in vehicle.read_text()


def test_records_differ_in_maneuver_mass_and_trim() -> None:
    flight = fly_surrogate(
        short(
            EVERY,
            records=(4, 4),
            maneuvers=("3-2-1-1", "doublets", "multisine", "hand-flown", "two"),
        ),
        7,
    )
    assert len(set(flight.drawn.kinds)) == 4
    masses = [flown.constants["mass"] for flown in flight.flown]
    assert 0.001 < np.std(masses) / np.mean(masses) < 0.03
    assert len({flown.constants["trim_alpha"] for flown in flight.flown}) == 4
