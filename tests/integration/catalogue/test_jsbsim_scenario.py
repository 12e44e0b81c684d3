"""`flightid simulate jsbsim` on the command line: refusals in one line, and a record that
identification takes.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from tests.integration.command_line import CommandLine

needs_jsbsim = pytest.mark.skipif(
    importlib.util.find_spec("jsbsim") is None,
    reason="JSBSim is not installed (pip install 'flightid[jsbsim]')",
)


def test_without_jsbsim_one_line_says_what_to_install(
    flightid: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "JSBSim is not installed" in flightid.refused("simulate", "jsbsim", "--out", "x.csv")
    assert "pip install 'flightid[jsbsim]'" in flightid.refused(
        "simulate", "jsbsim", "--out", "x.csv"
    )


@pytest.mark.sampled
@needs_jsbsim
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("aircraft=738", ("key aircraft", "no aircraft '738'", "did you mean")),
        ("aircraft=c172y", ("key aircraft", "no aircraft 'c172y'", "c172x")),
        ("aircraft=ball", ("key altitude", "no usual altitude is known of ball")),
        ("axis=sideways", ("key axis", "no axis 'sideways'", "lateral")),
        ("maneuver=loop", ("key maneuver", "no maneuver 'loop'", "multisine")),
        ("late.elevatr=0.1", ("key late", "'elevatr'", "'elevator'")),
        ("late.alpha=-1", ("key late.alpha", "above 0")),
        ("backlash.flap=1", ("key backlash", "'flap'")),
        ("duration=3", ("key duration", "8 s or more")),
        ("rate=1000", ("key rate", "400 Hz or less")),
        ("rough_air=9", ("key rough_air", "7 or less")),
        ("airspeed=20", ("altitude and airspeed", "does not trim", "give another")),
        ("colour=red", ("key colour",)),
    ],
)
def test_what_is_wrong_is_named(flightid: CommandLine, change: str, words: tuple[str, ...]) -> None:
    said = flightid.refused("simulate", "jsbsim", "--set", change, "--out", "x.csv")
    assert "jsbsim.toml" in said and all(word in said for word in words), said


def test_a_flight_is_no_study(flightid: CommandLine) -> None:
    assert "use flightid simulate jsbsim" in flightid.refused("run", "jsbsim")


@needs_jsbsim
@pytest.mark.slow
@pytest.mark.parametrize("name", ["c172x", "A320"])
@pytest.mark.parametrize("axis", ["lateral", "longitudinal"])
def test_true_derivatives_lie_within_the_intervals(
    flightid: CommandLine, tmp_path: Path, name: str, axis: str
) -> None:
    """Two independent writings of flight mechanics agree: the pooled error of the main derivatives
    is a few sigmas of noise, or two per cent.
    """
    record = tmp_path / "flight.csv"
    said = flightid.done(
        "simulate",
        "jsbsim",
        "--set",
        f"aircraft={name}",
        "--set",
        f"axis={axis}",
        "--out",
        str(record),
    )
    assert f"flightid identify {record} --model {axis}" in said
    flightid.done(
        "identify",
        str(record),
        "--model",
        axis,
        "--vehicle",
        str(tmp_path / f"flight_{axis}.toml"),
        "--no-figures",
        "--out",
        str(tmp_path / "s"),
    )
    found = json.loads((tmp_path / "s" / "comparison.json").read_text())["parameters"]
    truth = json.loads((tmp_path / "flight_truth.json").read_text())["in_maneuver"][axis]
    main = (
        ("Cl_p", "Cl_da", "Cn_beta", "Cn_dr")
        if axis == "lateral"
        else ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
    )
    for key in main:
        error = abs(found[key]["estimate"] - truth[key])
        assert error < max(3.0 * found[key]["std"], 0.04 * abs(truth[key])), key
