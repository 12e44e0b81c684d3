"""Planted spikes are found exactly; runs, heavy tails and switching inputs are no spikes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.statistics.noise_levels import (
    difference_from_neighbours,
    final_spikes,
    input_edges,
    input_spikes,
    provisional_mask,
    robust_sigma,
)
from sim.record import Channel, Record
from tests.bases import three_two_one_one

N = 400
SIGMA = 0.002


@dataclass(frozen=True)
class Planted:
    at: tuple[int, ...]
    sizes: tuple[float, ...]
    seed: int


@st.composite
def spikes(draw: st.DrawFn, least: float, margin: int) -> Planted:
    """One to six spikes at least ``margin`` samples apart, of ``least`` to 200 sigmas, either sign,
    the ends of the record included.
    """
    count = draw(st.integers(1, 6))
    gaps = draw(st.lists(st.integers(margin, N // 8), min_size=count, max_size=count))
    first = draw(st.integers(0, 40))
    at = first + np.concatenate([[0], np.cumsum(gaps[1:])]).astype(int)
    sizes = draw(
        st.lists(
            st.floats(least, 200.0).flatmap(lambda s: st.sampled_from([s, -s])),
            min_size=count,
            max_size=count,
        )
    )
    return Planted(
        tuple(int(i) for i in at), tuple(SIGMA * s for s in sizes), draw(st.integers(0, 30))
    )


def noise(seed: int, n: int = N) -> np.ndarray:
    """Gaussian noise cut at 3.3 sigmas: a large sample of the noise itself would be found too, and
    rightly.
    """
    return SIGMA * np.clip(np.random.default_rng(seed).standard_normal(n), -3.3, 3.3)


def spoilt(plant: Planted) -> np.ndarray:
    values = noise(plant.seed)
    values[list(plant.at)] += plant.sizes
    return values


def final(
    values: np.ndarray, valid: np.ndarray | None = None, blocked: np.ndarray | None = None
) -> tuple[list[int], list[int], list[float]]:
    """Samples set aside, samples claimed and their sizes, of one channel of one record."""
    valid = np.ones(len(values), dtype=bool) if valid is None else valid
    blocked = np.zeros(len(values), dtype=bool) if blocked is None else blocked
    masks, claims = final_spikes([], ["q"], [values[None]], [valid[None]], [blocked])
    claimed = [i for claim in claims for i in claim.samples]
    return (
        np.flatnonzero(~masks[0][0]).tolist(),
        claimed,
        [size for claim in claims for size in claim.sizes],
    )


@given(spikes(least=20.0, margin=7))
@settings(max_examples=60)
def test_provisional_masks_find_planted_spikes_and_nothing_else(plant: Planted) -> None:
    """A slow misfit below the spikes does not hide them, nor is it taken for one."""
    values = spoilt(plant) + 30.0 * SIGMA * np.sin(np.arange(N) / 40.0)
    keep = provisional_mask(values[None], np.ones((1, N), dtype=bool), np.zeros(N, dtype=bool))
    assert tuple(np.flatnonzero(~keep[0])) == plant.at


@given(spikes(least=13.0, margin=3))
@settings(max_examples=60)
def test_final_masks_find_planted_spikes_and_nothing_else(plant: Planted) -> None:
    values = spoilt(plant)
    aside, claimed, sizes = final(values)
    assert aside == claimed == list(plant.at)
    assert np.max(np.abs(np.array(sizes) - plant.sizes)) < 4.0 * SIGMA


@given(st.integers(10, N - 20), st.integers(2, 6), st.floats(20.0, 200.0), st.integers(0, 30))
@settings(max_examples=60)
def test_runs_are_no_spikes(first: int, length: int, size: float, seed: int) -> None:
    values = noise(seed)
    values[first : first + length] += size * SIGMA
    assert final(values)[:2] == ([], [])
    keep = provisional_mask(values[None], np.ones((1, N), dtype=bool), np.zeros(N, dtype=bool))
    assert np.all(keep)


@given(st.integers(10, N - 10), st.floats(20.0, 200.0))
def test_two_spikes_within_two_samples_are_a_run(at: int, size: float) -> None:
    values = noise(3)
    values[[at, at + 2]] += size * SIGMA
    assert final(values)[0] == []


def test_missing_samples_are_neither_masked_nor_claimed() -> None:
    plant = Planted((50, 120, 300), (0.1, -0.2, 0.1), 4)
    values = spoilt(plant)
    valid = np.random.default_rng(5).random(N) > 0.1
    valid[[50, 300]], valid[120] = True, False
    values[~valid] = 0.0
    assert final(values, valid)[1] == [50, 300]
    keep = provisional_mask(values[None], valid[None], np.zeros(N, dtype=bool))
    assert np.flatnonzero(~keep[0] & valid).tolist() == [50, 300]


def test_a_heavy_tailed_channel_claims_none_and_keeps_all() -> None:
    rng = np.random.default_rng(7)
    heavy = SIGMA * rng.standard_t(3, 1500)
    assert np.sum(np.abs(heavy) > 5.5 * robust_sigma(heavy)) > 3
    assert final(heavy) == ([], [], [])
    # The other channel of the same record is judged by itself.
    other = SIGMA * np.clip(rng.standard_normal(1500), -3.3, 3.3)
    other[700] += 0.1
    rows = np.array([heavy, other])
    masks, claims = final_spikes(
        [], ["alpha", "q"], [rows], [np.ones_like(rows, dtype=bool)], [np.zeros(1500, dtype=bool)]
    )
    assert [claim.channel for claim in claims] == ["q"] and claims[0].samples == (700,)
    assert np.all(masks[0][0])


def test_gaussian_noise_has_no_spikes_and_hardly_ever_counts_as_heavy_tailed() -> None:
    """5.5 sigmas are 4e-8 a sample; heavy at one record in a thousand, so that at most three of 300
    keep a planted spike.
    """
    rng = np.random.default_rng(11)
    unclaimed = 0
    for _ in range(300):
        values = rng.standard_normal(N)
        values[123] = 30.0
        aside = final(values)[0]
        assert aside in ([], [123])
        unclaimed += aside == []
    assert unclaimed <= 3


def test_near_the_edge_of_an_event_a_sample_is_set_aside_and_not_claimed() -> None:
    values = spoilt(Planted((100, 200), (0.1, 0.1), 8))
    blocked = np.zeros(N, dtype=bool)
    blocked[195:206] = True
    aside, claimed, _ = final(values, blocked=blocked)
    assert aside == [100, 200]
    assert claimed == [100]


def test_spikes_are_numbered_by_record_and_sigma_is_pooled() -> None:
    quiet, spiky = noise(1), spoilt(Planted((77,), (0.05,), 2))
    masks, claims = final_spikes(
        [],
        ["q"],
        [quiet[None], spiky[None]],
        [np.ones((1, N), dtype=bool)] * 2,
        [np.zeros(N, dtype=bool)] * 2,
    )
    assert [(claim.record, claim.samples) for claim in claims] == [(1, (77,))]
    assert np.all(masks[0]) and not masks[1][0, 77]


def test_a_channel_without_noise_has_no_spikes() -> None:
    assert final(np.zeros(50)) == ([], [], [])
    assert np.all(
        provisional_mask(np.zeros((1, 50)), np.ones((1, 50), dtype=bool), np.zeros(50, dtype=bool))
    )


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8])
def test_a_record_may_be_shorter_than_what_a_spike_is_compared_with(count: int) -> None:
    values = np.full(count, SIGMA) * (-1.0) ** np.arange(count)
    values[0] = 1.0
    aside, claimed, _ = final(values)
    assert aside == claimed and aside in ([], [0])
    assert provisional_mask(
        values[None], np.ones((1, count), dtype=bool), np.zeros(count, dtype=bool)
    ).shape == (1, count)


def test_neighbours_of_too_short_a_series_say_nothing() -> None:
    assert not np.any(difference_from_neighbours(np.arange(6.0) ** 3, np.ones(6, dtype=bool)))


@given(
    st.lists(st.integers(0, 60), min_size=1, max_size=5, unique=True),
    st.floats(0.3, 3.0),
    st.booleans(),
    st.sampled_from([0.0, 1e-5]),
)
@settings(max_examples=60)
def test_spikes_of_a_held_input_are_found_and_its_steps_are_not(
    places: list[int], height: float, up: bool, ripple: float
) -> None:
    time = np.arange(500) / 50.0
    clean = three_two_one_one(time) + ripple * np.random.default_rng(1).standard_normal(500)
    assert input_spikes(clean).size == 0
    # Six samples apart, and clear of the steps, where no rule could tell a spike from a pulse of
    # one sample.
    steps = np.flatnonzero(np.abs(np.diff(clean)) > 0.05)
    at = sorted(i for i in (10 + 7 * place for place in places) if np.min(np.abs(steps - i)) > 2)
    values = clean.copy()
    values[at] += (1.0 if up else -1.0) * 0.1 * height
    assert input_spikes(values).tolist() == at


@given(st.integers(2, 12), st.integers(0, 20))
def test_short_pulses_of_a_maneuver_are_no_spikes(length: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.repeat(rng.choice([-0.1, 0.0, 0.1], size=40), length)
    assert input_spikes(values).size == 0


def test_a_multisine_has_no_spikes() -> None:
    time = np.arange(1000) / 50.0
    values = sum(
        0.02 * np.sin(2.0 * np.pi * f * time + f**2) for f in (0.2, 0.5, 0.9, 1.4, 2.3, 3.7)
    )
    assert input_spikes(np.asarray(values)).size == 0


@pytest.mark.parametrize("reach", [1, 2])
def test_input_edges_mark_switches_and_their_neighbours(reach: int) -> None:
    time = np.arange(50) / 50.0
    values = np.where(np.arange(50) >= 20, 0.1, 0.0)
    record = Record(
        time, (Channel.of("elevator", "rad", values),), (Channel.of("q", "rad/s", np.zeros(50)),)
    )
    assert np.flatnonzero(input_edges(record, reach)).tolist() == list(
        range(20 - reach, 20 + reach + 1)
    )


@pytest.mark.parametrize("at", [1, 49])
def test_input_edges_do_not_reach_round_the_ends_of_a_record(at: int) -> None:
    values = np.where(np.arange(50) >= at, 0.1, 0.0)
    record = Record(
        np.arange(50) / 50.0,
        (Channel.of("elevator", "rad", values),),
        (Channel.of("q", "rad/s", np.zeros(50)),),
    )
    assert np.flatnonzero(input_edges(record)).tolist() == [
        i for i in (at - 1, at, at + 1) if i < 50
    ]


def test_an_input_at_rest_has_no_edges() -> None:
    record = Record(
        np.arange(5.0),
        (Channel.of("elevator", "rad", np.full(5, 0.3)),),
        (Channel.of("q", "rad/s", np.zeros(5)),),
    )
    assert not np.any(input_edges(record))


def test_a_residual_that_is_all_tail_is_heavy_tailed() -> None:
    """Hundreds of samples in the tail, more than a power or a factorial takes as a float."""
    residual = np.random.default_rng(4).standard_t(1.2, (1, 4000))
    valid = np.ones((1, 4000), dtype=bool)
    masks, spikes = final_spikes([], ["q"], [residual], [valid], [np.zeros(4000, dtype=bool)])
    assert spikes == [] and masks[0].all()
