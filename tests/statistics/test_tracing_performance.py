"""False alarms on clean records and detection of weak effects by the tracing loop, with confidence
intervals.
"""

from __future__ import annotations

import numpy as np
import pytest

from exam.clean import MODELS, clean_flight
from exam.detection import SETTINGS, WEAK, Finding, clean_run, weak_run, weak_setting
from exam.random_cases.case_scoring import summary
from exam.random_cases.examination import examine
from exam.scoring import share_within_flights
from ident.statistics.intervals import clopper_pearson

RUNS = 200  # clean records over all settings
CLEAN_RUNS = 70  # of seven models
WEAK_RUNS = 12  # of each effect
CASES = 200


@pytest.mark.slow
def test_false_claims_on_clean_records_are_rare() -> None:
    alarms = [clean_run(SETTINGS[seed % len(SETTINGS)], seed) for seed in range(RUNS)]
    claims = [alarm for alarm in alarms if alarm.claimed]
    assert len(claims) <= 0.05 * RUNS, claims
    assert clopper_pearson(len(claims), RUNS)[0] < 0.05


@pytest.mark.slow
def test_clean_records_of_every_model_and_their_sigmas() -> None:
    """No more than one in a hundred claimed falsely, 93 to 97 % of derivatives within two sigmas,
    sigmas at the bound: none of it is excluded.
    """
    runs = [clean_flight(seed, MODELS[seed % len(MODELS)]) for seed in range(CLEAN_RUNS)]
    claims = [run for run in runs if run.claimed]
    assert clopper_pearson(len(claims), CLEAN_RUNS)[0] < 0.01, claims
    within = share_within_flights(
        [abs(error) <= 2.0 for error in run.errors.values()] for run in runs
    )
    assert within.interval[1] >= 0.93 and within.interval[0] <= 0.97
    over = [ratio for run in runs for ratio in run.over_bound.values()]
    assert 0.95 < np.median(over) < 1.1 and np.quantile(over, 0.05) > 0.85


@pytest.mark.slow
def test_effects_of_gain_25_are_detected_and_named() -> None:
    found = [
        weak_run(weak_setting(effect), effect, 25.0, seed)
        for effect in WEAK
        for seed in range(WEAK_RUNS)
    ]
    seen = [detection for detection in found if detection.finding is not Finding.MISSED]
    named = [
        detection for detection in found if detection.finding in (Finding.RIGHT, Finding.AMBIGUOUS)
    ]
    assert clopper_pearson(len(seen), len(found))[1] >= 0.95
    assert clopper_pearson(len(named), len(found))[1] >= 0.80


@pytest.mark.slow
def test_random_cases_are_answered_right() -> None:
    """Models, vehicles, rates, channels, maneuvers, sizes, pairs, foreign causes and recorder
    faults at random.

    At least 95 % right, at most 1 % with a wrong name, and 94 to 97 % of derivatives within two
    sigmas: none of it is excluded at 95 %.
    """
    found = summary([examine(seed) for seed in range(300, 300 + CASES)])
    right, wrong = round(found["right"] * CASES), round(found["wrong claims"] * CASES)
    assert clopper_pearson(right, CASES)[1] >= 0.95
    assert clopper_pearson(wrong, CASES)[0] <= 0.01
    assert found["derivatives within two sigmas, upper 95 %"] >= 0.94
    assert found["derivatives within two sigmas, lower 95 %"] <= 0.97
    assert found["held-out error, median"] <= 1.05
