"""Process noise by the likelihood of a record."""

from __future__ import annotations

import pytest

from sim.errors import ModelError
from tests import loes_problem as problem
from tests.density_choice import choose_density

DELAYS = (0.105, 0.118, 0.13)


def test_a_record_without_process_noise_asks_for_little_and_one_with_it_for_some() -> None:
    quiet = problem.record(9, duration=4.0)
    found = choose_density(
        quiet, lambda d: problem.system(quiet, 1.0, {"q": d}), (0.0, 1e-6, 1e-3), delays=DELAYS
    )
    assert found.chosen == 0.0 and found.innovation_ratio[0] == pytest.approx(1.0, abs=0.15)
    assert found.log_likelihood[2] < found.log_likelihood[0] - 3.0 and found.delays[0] == 0.118


def test_a_wrong_model_asks_for_process_noise() -> None:
    quiet = problem.record(9, duration=4.0)
    found = choose_density(
        quiet, lambda d: problem.system(quiet, 1.0, {"q": d}), (0.0, 1e-5, 1e-3), delays=(0.0, 0.01)
    )
    assert found.chosen > 0.0


def test_filters_that_all_break_down_are_told() -> None:
    quiet = problem.record(9, duration=2.0)
    with pytest.raises(ModelError, match="every filter broke down"):
        choose_density(
            quiet, lambda d: problem.system(quiet, 1e60, {"q": d}), (0.0,), delays=DELAYS
        )
