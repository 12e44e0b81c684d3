"""Probabilities of names held against the truth: counted by what was said."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest

from exam.scoring import EDGES, Bin, Statement, binned, reliability


def said(probability: float, *right: bool) -> list[Statement]:
    """Claims with this probability, right or not."""
    return [Statement("a", probability, each) for each in right]


def test_names_are_counted_by_what_was_said_of_them() -> None:
    bins = reliability(
        [*said(0.675, True, True, False), *said(0.725, True), *said(0.225, False, True)]
    )
    assert [(item.low, item.high) for item in bins] == list(pairwise(EDGES))
    counted = {(item.low, item.high): item for item in bins if item.count}
    assert {key: (item.count, item.right) for key, item in counted.items()} == {
        (0.2, 0.5): (2, 1),
        (0.5, 0.8): (4, 3),
    }
    assert counted[(0.5, 0.8)].said == pytest.approx(0.6875) and counted[
        (0.2, 0.5)
    ].said == pytest.approx(0.225)
    empty = next(item for item in bins if not item.count)
    assert empty.said == pytest.approx(0.5 * (empty.low + empty.high)) and empty.right == 0


def test_an_edge_belongs_to_what_lies_below_it_and_what_is_hardly_probable_is_left_out() -> None:
    bins = reliability(
        [*said(0.95, True), *said(1.0, True), *said(0.05, False), *said(0.04, False)]
    )
    assert [item.count for item in bins] == [0, 0, 0, 1, 1]
    # Without the filter the lowest edge is open as well.
    assert [item.count for item in binned([(0.05, False), (0.051, False)])] == [1, 0, 0, 0, 0]


def test_the_interval_holds_the_share_that_is_right() -> None:
    """Clopper and Pearson, 95 %: of ten right in ten the lower end is .025 ** .1."""
    low, high = Bin(0.95, 1.0, 10, 0.99, 10).interval
    assert low == pytest.approx(0.025**0.1, rel=1e-6) and high == 1.0
    low, high = Bin(0.5, 0.8, 4, 0.7, 2).interval
    assert low < 0.5 < high


def test_true_probabilities_are_found_to_be_so() -> None:
    """Names that are right as often as is said lie inside their intervals, overconfident ones
    outside.
    """
    rng = np.random.default_rng(5)
    p = rng.uniform(0.05, 1.0, 4000)
    u = rng.random(4000)
    honest = reliability(
        [Statement("a", float(each), bool(draw < each)) for each, draw in zip(p, u, strict=True)]
    )
    bold = reliability(
        [Statement("a", float(each), bool(draw < each**2)) for each, draw in zip(p, u, strict=True)]
    )
    inside = [
        [item.interval[0] <= item.said <= item.interval[1] for item in bins]
        for bins in (honest, bold)
    ]
    assert all(inside[0]) and not any(inside[1][:-1])


def test_a_statement_is_kept_as_plain_data() -> None:
    told = Statement("sensor-lag:q", 0.93, True)
    assert Statement(**json.loads(json.dumps(asdict(told)))) == told
