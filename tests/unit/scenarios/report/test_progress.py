"""How far long work is: words of it, plain lines where no terminal is, nothing where nothing is to
be shown.
"""

from __future__ import annotations

import time

import pytest

from scenarios.report import terminal
from scenarios.report.terminal import LastProgress, progress_bar, time_text


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min"),
        (200.0, "3 min 20 s"),
        (7500.0, "2 h 5 min"),
        (86400.0, "24 h"),
    ],
)
def test_a_time_is_told_in_two_units_at_most(seconds: float, words: str) -> None:
    assert time_text(seconds) == words


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.25, "3 of 12 flights, 20 s, about 1 min left"),
        (0.0, "3 of 12 flights, 20 s"),
        (1.0, "3 of 12 flights, 20 s"),
        (0.99, "3 of 12 flights, 20 s"),
    ],
)
def test_what_is_left_follows_from_the_share_done(share: float, words: str) -> None:
    assert LastProgress("3 of 12 flights", share, since=100.0).line(120.0) == words


def test_lines_where_stderr_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "PLAIN_LINE_INTERVAL", 0.05)
    begun = time.monotonic() - 30.0
    with progress_bar(counted=False, before=(1, 2, begun)) as tell:
        tell("second: searching", 0.7)
        time.sleep(0.2)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    # One of two is done after 30 s; what a search says of its share is no time.
    assert out == "" and 1 <= len(lines) <= 4
    assert {line.rpartition(" s, ")[0].rpartition(", ")[0] for line in lines} == {
        "flightid: 2 of 2: second: searching"
    }
    assert all(line.endswith(", about 30 s left") for line in lines)


def test_nothing_is_shown_of_short_work_or_where_it_is_not_wanted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with progress_bar() as tell:
        tell("short", 0.5)
    monkeypatch.setattr(terminal, "PLAIN_LINE_INTERVAL", 0.01)
    with progress_bar(False) as tell:
        tell("quiet", 0.5)
        time.sleep(0.05)
    assert capsys.readouterr() == ("", "")
