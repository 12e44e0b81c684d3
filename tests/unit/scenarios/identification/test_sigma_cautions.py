"""Cautions on sigmas that are too small: in gusts for methods that take no account of them, and nowhere else."""

from __future__ import annotations

import pandas as pd
import pytest

import flightid
from scenarios.identification.sigma_cautions import FILTER_ERROR, SHORT_IN_GUSTS
from scenarios.trials.coverage.independent_flights import flown


def cautions(method: str, noise: str, run: int = 0) -> list[str]:
    flight = flown("rigid", noise, run)
    vehicle = {**flight.vehicle, "derivatives": dict(flight.start)}
    frame = pd.DataFrame(flight.columns)
    found = flightid.identify(frame, "rigid", vehicle, method=method, hold="previous")
    return [each for each in found.warnings if "too small" in each]


@pytest.mark.parametrize("method", sorted(SHORT_IN_GUSTS))
@pytest.mark.parametrize("noise", ["markov-gusts", "dryden-gusts"])
def test_gusts_are_cautioned_with_their_factor(method: str, noise: str) -> None:
    (said,) = cautions(method, noise)
    factor, held = SHORT_IN_GUSTS[method]
    assert f"sigmas of {method} are up to {factor:g} times too small" in said and f"{100 * held:.0f} %" in said


@pytest.mark.parametrize("method", sorted(SHORT_IN_GUSTS))
@pytest.mark.parametrize("noise", ["white", "ar1"])
def test_noise_of_each_sensor_by_itself_is_not(method: str, noise: str) -> None:
    assert [said for run in range(4) for said in cautions(method, noise, run)] == []


def test_filter_error_is_cautioned_where_it_finds_gusts() -> None:
    (said,) = cautions("filter-error", "markov-gusts")
    factor, held = FILTER_ERROR
    assert f"sigmas of filter-error are up to {factor:g} times too small" in said
    assert f"{100 * held:.0f} %" in said
    assert cautions("filter-error", "white") == []


def test_methods_that_hold_in_gusts_are_not_cautioned() -> None:
    assert cautions("equation-error", "dryden-gusts") == []
