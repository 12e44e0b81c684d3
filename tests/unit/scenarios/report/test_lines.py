"""Single lines: residual tests by axis, and levels of flying qualities with what is assumed and
what is doubted.
"""

from __future__ import annotations

import pytest

from ident.flying_qualities.levels import FlightPhase, ModeLevel
from ident.statistics.residuals import ResidualTest
from scenarios.report.quantities import test_line as line_of
from scenarios.report.summary import level_text, levels_line


def whiteness(channel: str, p_value: float) -> ResidualTest:
    return ResidualTest(
        "ljung-box", channel, 40.0, p_value, "white" if p_value > 1e-3 else "not white"
    )


MORE = "residual is more than noise (residual: measured minus predicted): "
LATERAL = ("beta", "p", "r", "phi", "ny")


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (("r",), "r (yaw): not white; consistent with noise in side force and roll"),
        (
            ("p", "phi"),
            "p (roll): not white; phi (roll): not white; "
            "consistent with noise in side force and yaw",
        ),
        (
            ("ny", "r"),
            "ny (side force): not white; r (yaw): not white; consistent with noise in roll",
        ),
        (
            LATERAL,
            "beta (side force): not white; ny (side force): not white; p (roll): not white; "
            "phi (roll): not white; r (yaw): not white",
        ),
    ],
)
def test_the_axis_that_fails_is_named(wrong: tuple[str, ...], expected: str) -> None:
    told = line_of([whiteness(name, 1e-9 if name in wrong else 0.4) for name in LATERAL])
    assert told == f"{MORE}{expected}"


def test_one_axis_needs_no_name_and_a_test_of_all_outputs_has_none() -> None:
    assert line_of([whiteness("altitude", 1e-9)]) == f"{MORE}altitude: not white"
    assert line_of([whiteness("q", 1e-9), whiteness("theta", 0.5)]) == f"{MORE}q: not white"
    size = ResidualTest("nis", "all", 9.0, 1e-9, "innovations are 2 times the size")
    told = line_of([whiteness("airspeed", 0.3), whiteness("q", 0.3), size])
    assert told == (
        f"{MORE}all: innovations are 2 times the size; consistent with noise in speed and pitch"
    )
    assert (
        line_of([whiteness("q", 0.3)])
        == "residual: consistent with noise (q: p-value 0.3; a test fails below 0.0001)"
        and line_of([]) == ""
    )


def level(
    shares: tuple[float, ...], decided: str = "", value: float = 0.0, limit: float = 0.0
) -> ModeLevel:
    return ModeLevel(
        "Dutch roll",
        shares.index(max(shares)) + 1,
        shares,
        decided,
        value,
        limit,
        ("MIL-F-8785C 3.3.1.1, table VI",),
    )


def test_a_level_is_told_with_its_probability_or_not_at_all() -> None:
    assert level_text(level((0.97, 0.03, 0.0, 0.0))) == "level 1 (97 %)"
    assert level_text(level((0.9999, 0.0001, 0.0, 0.0))) == "level 1 (> 99.9 %)"
    assert level_text(level((0.0, 0.006, 0.0, 0.994))) == "below level 3 (99.4 %)"
    assert (
        level_text(level((0.3, 0.69, 0.005, 0.005)))
        == "not determined (level 2 69 %, level 1 30 %)"
    )


def test_what_is_assumed_and_what_is_doubted_is_said() -> None:
    some = [level((0.0, 1.0, 0.0, 0.0), "dutch_roll_damping_rate", 0.12, 0.15)]
    sound, bad = [whiteness("r", 0.3)], [whiteness("r", 1e-9)]
    told = (
        "Dutch roll level 2 (> 99.9 %): damping ratio times frequency 0.12 rad/s, asked at least "
        "0.15 rad/s"
    )
    assert (
        levels_line(some, FlightPhase("IV", "A", ()), sound)
        == f"levels by MIL-F-8785C, class IV, category A: {told}"
    )
    assert (
        "class II-L, category B (class and category assumed, as neither an option "
        "(--class, --category) nor the vehicle file gives it; class II-L is for medium weight: "
        "I is light, III large, IV a fighter): " in levels_line(some, FlightPhase(), sound)
    )
    assert levels_line(some, FlightPhase("IV", "A", ()), bad).startswith(
        "levels by MIL-F-8785C, class IV, category A, not valid here, because the residual shows"
    )
    assert levels_line([], FlightPhase(), sound) == ""
