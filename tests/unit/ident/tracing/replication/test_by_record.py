"""Does an effect come out alike from each record, and how are some of them fitted."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.diagnosis import Quantity
from ident.tracing.replication.by_record import Flight, _alike, _may_differ, distance_from_absence, most_telling, recordings, replicate
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_covariance
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.sensor_path.sensor_delay import SensorDelay
from tests.tracing_problem import all_records, doublets, part, planted

LATE = SensorDelay("alpha")


def test_what_differs_from_record_to_record_does_not_replicate(late: Flight) -> None:
    """A delay in one record of three."""
    one = planted([LATE], {"sensor-delay:alpha.delay": 0.12}, 1)
    flight = all_records([one, planted([], None, 2), planted([], None, 3)])
    fitted = flight.fit((LATE,), range(3), None, {"sensor-delay:alpha.delay": 0.04})
    assert fitted is not None
    copies = replicate(flight, fitted, LATE)
    assert not copies.agrees
    assert [found["delay"].value for found in copies.values] == [pytest.approx(0.12, abs=0.01), *[pytest.approx(0.0, abs=0.01)] * 2]


def test_settings_for_replication_are_those_of_a_search() -> None:
    """A fit of a Flight is that of the engine at twice the declared step."""
    flight = all_records([planted([], None, 1)])
    fitted = flight.fit((), [0], None)
    assert fitted is not None and fitted.fit.layout.settings.max_step == FitSettings(max_step=0.04).max_step
    assert not any(isinstance(effect, GustDiscrete) for effect in fitted.effects)


def told(*pairs: tuple[float, float]) -> list[Quantity]:
    """Values with their sigmas."""
    return [Quantity(value, std, "s") for value, std in pairs]


def test_values_from_several_records_are_weighed_by_what_each_knows() -> None:
    """One record that knows it and many that hardly do are one value where each of these bears the known one."""
    assert _alike(told((1.0, 0.01), *[(2.45, 0.5)] * 8), 0.0)
    assert not _alike(told((1.0, 0.01), *[(2.8, 0.5)] * 8), 0.0)
    # But no record knows it better than a twentieth of it.
    assert _alike(told((1.0, 1e-9), (1.2, 1e-9), (1.1, 1e-9)), 0.0)


def test_an_effect_stands_off_its_absence_in_all_records_but_one() -> None:
    assert _alike(told((1.0, 0.1), (1.0, 0.2), (1.0, 0.8)), 0.0)
    assert not _alike(told((1.0, 0.1), (1.0, 0.8), (1.0, 0.8)), 0.0)
    # From another absence it is the distance that counts, and a clear value on the other side is another cause.
    assert _alike(told((1.2, 0.02), (1.2, 0.02)), 1.0) and not _alike(told((1.2, 0.15), (1.2, 0.15)), 1.0)
    assert not _alike(told((0.3, 0.1), (0.3, 0.1), (-0.3, 0.1)), 0.0)


def test_of_a_limit_two_records_have_to_know_it() -> None:
    assert _alike(told((1.0, 0.1), (1.0, 0.3), (1.0, 5.0)), None)
    assert not _alike(told((1.0, 0.1), (1.0, 0.8), (1.0, 0.8)), None)
    assert _alike(told((1.0, 0.1)), None) and not _alike(told((1.0, 0.8)), None)


def test_the_distance_from_absence_is_walds_per_parameter(late: Flight) -> None:
    """Of one parameter its sigmas; of four the root of the mean square of what is independent in them."""
    one = late.fit((LATE,), range(3), None, {"sensor-delay:alpha.delay": 0.07})
    assert one is not None
    shown = most_telling(one, LATE)["delay"]
    assert distance_from_absence(one, LATE) == pytest.approx(shown.value / shown.std)
    four = late.fit((MOMENT_NONLINEARITY,), range(3), None)
    assert four is not None
    at = [four.fit.layout.names.index(f"moment-nonlinearity.{name}") for name in MOMENT_NONLINEARITY.absent]
    covariance, away = fit_covariance(four.fit)[0][np.ix_(at, at)], four.fit.theta[at]
    assert distance_from_absence(four, MOMENT_NONLINEARITY) == pytest.approx(np.sqrt(away @ np.linalg.solve(covariance, away) / 4.0), rel=1e-5)


def test_the_last_part_of_a_record_is_no_other_recording() -> None:
    one, other = planted([], None, 1), planted([], None, 2)
    first, held = part(one, slice(0, 350)), part(one, slice(350, 500))
    assert recordings([first, held]) == 1 and recordings([first, held, other]) == 2
    # Two files of one name begin at the same time, and two maneuvers cut from one file do not follow each other.
    assert recordings([one, other]) == 2
    assert recordings([part(one, slice(0, 200)), part(one, slice(300, 500))]) == 2


def test_of_many_parameters_what_they_do_has_to_agree() -> None:
    """A curve that turns over from record to record does not replicate, one that is the same does."""
    truth = {f"moment-nonlinearity.{name}": value for name, value in (("left", 0.08), ("middle", -0.05), ("right", 0.06))}
    names = [item.name for item in MOMENT_NONLINEARITY.parameters if item.free]
    values = dict(zip([f"moment-nonlinearity.{name}" for name in names], truth.values(), strict=False))
    turned = {name: -value for name, value in values.items()}

    def agrees(*planted_values: dict[str, float]) -> bool:
        flight = all_records([planted([MOMENT_NONLINEARITY], each, seed) for seed, each in enumerate(planted_values)])
        fitted = flight.fit((MOMENT_NONLINEARITY,), range(len(planted_values)), None, dict(values))
        assert fitted is not None
        return replicate(flight, fitted, MOMENT_NONLINEARITY).agrees

    assert agrees(values, values) and not agrees(values, turned)


@pytest.mark.parametrize(
    ("losses", "agrees"),
    [
        ((0.1, 0.1, 0.1, 0.1), True),
        ((0.1, 0.1, 0.1, 0.4), True),
        ((0.1, 0.1, 0.1, 0.6), False),
        ((0.1, 0.1, 0.4, 0.4), False),
        ((0.1, 0.1, 0.4), False),
    ],
    ids=["all agree", "one of four by a little", "one of four by much", "two of four", "one of three"],
)
def test_of_four_records_one_may_differ_where_the_common_values_still_do_most(
    monkeypatch: pytest.MonkeyPatch, losses: tuple[float, ...], agrees: bool
) -> None:
    """``losses`` : what the common values lose in each record, over what the effect brings there; a sixth is no difference."""
    flight = all_records([planted([], None, seed, flight=doublets(4.0, 25.0)) for seed in range(len(losses))])
    fitted = flight.fit((MOMENT_NONLINEARITY,), range(len(losses)), None)
    assert fitted is not None
    told = iter([part for lost in losses for part in (1e6 * lost, 1e6)])
    monkeypatch.setattr("ident.tracing.replication.by_record.squared_distance", lambda *of: next(told))
    assert replicate(flight, fitted, MOMENT_NONLINEARITY).agrees is agrees


@pytest.mark.parametrize(
    ("lost", "whole", "may"),
    [(459.0, 190.0, True), (459.0, 900.0, False), (300.0, 900.0, True), (84.0, 102.0, True)],
)
def test_one_record_of_many_may_differ_where_it_tells_little_or_loses_little(lost: float, whole: float, may: bool) -> None:
    """What others lose with the common values, and what the effect brings in them, are those of a flight with an elastic mode."""
    others = [(3.0, 1619.0), (6.0, 1715.0), (8.0, 844.0), (4.0, 882.0)] if whole > 150.0 else [(34.0, 814.0), (18.0, 441.0), (33.0, 610.0)]
    assert _may_differ([*others, (lost, whole)], len(others)) is may
