"""Turns are taken, nobody is counted before being warm, and ratios are those of the same round."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.comparison.timing import FEWEST, SHORTEST, interleaved, quartiles, ratios


class Clock:
    """A clock that only work moves."""

    def __init__(self) -> None:
        self.now = 0.0
        self.calls: list[str] = []

    def __call__(self) -> float:
        return self.now

    def work(self, name: str, seconds: float) -> Callable[[], None]:
        def do() -> None:
            self.calls.append(name)
            self.now += seconds

        return do


def test_everybody_takes_turns() -> None:
    clock = Clock()
    times = interleaved({"a": clock.work("a", 1.0), "b": clock.work("b", 2.0)}, 4, 1e9, clock)
    assert clock.calls == ["a", "a", "b", "b"] + ["a", "b"] * 4
    assert times == {"a": [1.0] * 4, "b": [2.0] * 4}


def test_the_slow_drop_out_after_the_fewest_rounds() -> None:
    clock = Clock()
    times = interleaved(
        {"quick": clock.work("quick", 0.5), "slow": clock.work("slow", 50.0)}, 9, 10.0, clock
    )
    assert len(times["quick"]) == 9 and len(times["slow"]) == FEWEST


def test_what_is_short_is_done_several_times() -> None:
    clock = Clock()
    times = interleaved({"short": clock.work("short", SHORTEST / 10.0)}, 2, 1e9, clock)
    assert len(clock.calls) == 2 + 2 * 10
    np.testing.assert_allclose(times["short"], SHORTEST / 10.0)


def test_ratios_are_of_the_same_round() -> None:
    # Both twice as slow in the second round: the ratio does not notice.
    found = ratios([3.0, 6.0, 3.0], [1.0, 2.0, 1.0, 7.0])
    assert found == (3.0, 3.0, 3.0, 3)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_quartiles_are_in_order(count: int) -> None:
    found = quartiles(np.random.default_rng(count).uniform(1.0, 2.0, count).tolist())
    assert found.lower <= found.median <= found.upper and found.number == count
