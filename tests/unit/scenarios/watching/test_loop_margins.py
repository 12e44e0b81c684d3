"""A loop whose signals arrive row by row: margins against the whole record's and the truth."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import signal

from scenarios.responses.loops import margin_lines
from scenarios.watching.loop_margins import (
    LoopNames,
    MarginSession,
    finish_second,
    history_csv,
    loop_names,
    margin_content,
    margins_of,
    take,
)
from scenarios.watching.show import FollowLoop
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import loop_test, margins
from sim.errors import DeclarationError

NAMES = LoopNames("minus", "command", "returned", "sweep")


def flown(seed: int = 1, duration: float = 60.0) -> np.ndarray:
    """Time, command, sweep and returned signal of a sweep of the X-29-like loop, ``(4, N)``."""
    x29 = load_x29("F")
    time = x29.frame * np.arange(int(duration / x29.frame))
    sweep = 0.5 * signal.chirp(time, 0.2, duration, 10.0, method="logarithmic")
    rows = loop_test(x29, sweep, np.random.default_rng(seed))
    return np.stack([time, rows[1], rows[0], rows[2]])


def watched(rows: np.ndarray, pieces: int = 1, names: LoopNames = NAMES) -> MarginSession:
    session = MarginSession(names, "loop", (0.3, 10.0))
    for part in np.array_split(rows, pieces, axis=1):
        take(session, part)
    finish_second(session)
    return session


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    return flown()


@pytest.fixture(scope="module")
def session(rows: np.ndarray) -> MarginSession:
    return watched(rows)


@pytest.mark.long
def test_the_known_margins_are_held_as_soon_as_the_sweep_has_passed(session: MarginSession) -> None:
    exact, last = margins(load_x29("F")), session.points[-1].margins
    assert last is not None and last.phase is not None and last.gain_increase is not None
    assert last.phase.low - 1.0 < exact.phase < last.phase.high + 1.0
    assert last.gain_increase.low - 0.2 < exact.gain_increase < last.gain_increase.high + 0.2
    # What a sweep has not reached yet has leaked from where it is: nothing is said of it.
    early = [point for point in session.points if point.time < 20.0]
    assert len(early) >= 15
    assert all(point.margins is None or point.margins.phase is None for point in early)


@pytest.mark.long
def test_a_margin_is_shown_once_the_sweep_has_passed_its_crossing(session: MarginSession) -> None:
    """Before, the response at the crossing is extrapolated from below and off by many sigmas."""
    exact = margins(load_x29("F"))
    passes = 60.0 * np.log(exact.crossover / (2.0 * np.pi) / 0.2) / np.log(50.0)
    known = [each for each in session.points if each.margins is not None and each.margins.phase]
    first = known[0].margins
    assert passes < known[0].time < passes + 8.0
    assert first is not None and first.phase is not None
    assert first.phase.low < exact.phase < first.phase.high
    for each in known:
        assert each.margins is not None and each.band is not None
        for margin in (*each.margins.gains, *each.margins.phases):
            assert each.band[0] * 1.1 < margin.frequency.value < each.band[1] / 1.1


@pytest.mark.long
def test_how_rows_come_makes_no_difference(rows: np.ndarray) -> None:
    short = rows[:, :2400]
    one, many = watched(short), watched(short, 53)
    assert history_csv(one) == history_csv(many)
    assert len(one.points) == len(many.points) >= 28


@pytest.mark.long
def test_gaps_are_joined_or_end_a_window(rows: np.ndarray) -> None:
    short = rows[:, :2400].copy()
    missing = short.copy()
    missing[3, 700] = np.nan
    lost = np.delete(short, np.arange(1000, 1040), axis=1)
    assert watched(missing).gaps == 0 and watched(lost).gaps == 1
    assert watched(missing).stream.samples == watched(short).stream.samples == 2400  # type: ignore[union-attr]
    assert watched(lost).stream.samples == 2400  # type: ignore[union-attr]


@pytest.mark.long
def test_a_missing_sample_hardly_changes_anything(rows: np.ndarray, session: MarginSession) -> None:
    missing = rows.copy()
    missing[3, [900, 1800, 2700]] = np.nan
    both = [each.points[-1].margins for each in (watched(missing), session)]
    assert both[0] is not None and both[1] is not None
    assert both[0].phase is not None and both[1].phase is not None
    assert both[0].phase.size.value == pytest.approx(both[1].phase.size.value, abs=0.3)


def test_what_is_written(session: MarginSession) -> None:
    content = margin_content(session)
    assert content["margins"]["pooled"]["phase_margin"]["unit"] == "deg"
    assert content["method"] == "joint input-output" and not content["warnings"]
    lines = history_csv(session).splitlines()
    assert len(lines) == len(session.points) + 1
    assert {len(line.split(",")) for line in lines} == {23}


@pytest.mark.long
def test_without_the_excitation_a_bias_is_said(rows: np.ndarray) -> None:
    loop = margins_of(watched(rows[[0, 1, 3]], names=LoopNames("minus", "command", "returned")))
    assert loop is not None and "direct estimate" in loop.cautions[0]


class Heard:
    """A feed that keeps what it is told."""

    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []

    def put(self, name: str, line: str, rows: int = 0) -> None:
        self.events.append((name, json.loads(line)))


def test_the_live_page_hears_intervals_and_what_is_required(session: MarginSession) -> None:
    watch = cast("Any", SimpleNamespace(name="loop.csv", left_out=0, heard=0.0, reason="ended"))
    heard = Heard()
    follow = FollowLoop(watch, session, cast("Any", heard))
    follow.rows(np.array([[0.0, 0.1], [1.0, np.nan], [0.0, 0.0], [2.0, 3.0]]))
    follow.end()
    told = dict(heard.events)
    assert told["about"]["loop"]["standard"] == "required by MIL-F-9490D"
    assert [each["name"] for each in told["about"]["strips"]] == ["command", "sweep", "returned"]
    assert told["rows"]["command"] == [1.0, None]
    items = {each["name"]: each for each in told["final"]["items"]}
    last = session.points[-1].margins
    assert last is not None and last.phase is not None
    phase = items["phase_margin"]
    assert (phase["low"], phase["high"]) == (last.phase.low, last.phase.high)
    assert phase["required"] == 45.0 and items["gain_increase"]["required"] == 6.0
    assert "required" not in items["distance"] and items["distance"]["unit"] == ""


def test_a_sign_and_one_signal_each_are_needed() -> None:
    with pytest.raises(DeclarationError, match="no sign"):
        loop_names("times", ("a",), ("b",), None)
    with pytest.raises(DeclarationError, match="no single loop"):
        loop_names("minus", ("a", "c"), ("b",), None)


def test_the_wrong_sign_of_a_loop_is_not_compared(rows: np.ndarray) -> None:
    right = margins_of(watched(rows))
    wrong = margins_of(watched(rows, names=LoopNames("plus", "command", "returned", "sweep")))
    assert right is not None and not right.contradicted
    assert any("MIL-F-9490D, below" in line for line in margin_lines(right))
    assert wrong is not None and wrong.contradicted
    assert not any("MIL-F-9490D, below" in line for line in margin_lines(wrong))
    assert any("--margins minus fits these signals" in each for each in wrong.cautions)
