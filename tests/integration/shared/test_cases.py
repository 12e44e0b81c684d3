"""Every small input that once failed, from the file through the command line: the numbers and
messages that its README asks for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command_line import CommandLine

CASES = Path(__file__).parents[4] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the folder of shared cases is not here")
RECORDS = (".csv", ".asc", ".txt", ".mat")
BOMBER = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
MATRIX = "time = 1\nelevator = 2\nalpha = 3\nq = 4\n"
IDDATA = 'elevator = "u"\nalpha = "y1"\nq = "y2"\n'
ELEVONS = (
    'elevator = {column = "0.5*((elevon_right_pwm - 1510)/8 - (elevon_left_pwm - 1500)/8)", unit = '
    '"deg"}\n'
)
# File -> what opens it besides the model and the vehicle file.
SAME: dict[str, tuple[str, list[str]]] = {
    "text-forms/blank.asc": ("", []),
    "text-forms/pipe.txt": ("", []),
    "text-forms/preamble.csv": ("", []),
    "text-forms/caps.csv": ("", []),
    "text-forms/latin.csv": ("", []),
    "text-forms/iso.csv": ("", []),
    "text-forms/hms.csv": ("", []),
    "text-forms/noheader.asc": ("", ["--columns", "time,elevator,alpha,q"]),
    "text-forms/notime.csv": ("", ["--rate", "50"]),
    "mat-forms/matrix.mat": (MATRIX, []),
    "mat-forms/matrix_names.mat": ("", []),
    "mat-forms/nested.mat": ("", []),
    "mat-forms/v73.mat": ("", []),
    "mat-forms/idd.mat": (IDDATA, []),
    "topics-merged/duplicates.csv": ("", []),
    "topics-merged/unsorted.csv": ("", []),
}
OTHERS = (
    "altitude-units/coast_feet.csv",
    "altitude-units/fall_km.csv",
    "equation-error-missing-rows/roll.csv",
    "lateral-time-gap/gap.csv",
    "maneuver-as-noise/small.csv",
    "mixed-surfaces/elevons.csv",
    "time-three-digits/zigzag.csv",
    "topics-merged/multirate_input.csv",
    "topics-merged/topics.csv",
)


def test_every_case_has_a_test() -> None:
    present = {
        path.relative_to(CASES).as_posix() for path in CASES.rglob("*") if path.suffix in RECORDS
    }
    assert present <= {*SAME, *OTHERS}


def identified(flightid: CommandLine, out: Path, name: str, *options: object) -> dict[str, Any]:
    """What an identification of a case writes, with the vehicle file beside it where there is
    one."""
    path = CASES / name
    if not path.is_file():
        pytest.skip(f"{name} is not here")
    flightid.done("identify", path, *options, "--no-figures", "--out", out)
    content: dict[str, Any] = json.loads((out / "comparison.json").read_text())
    return content


@pytest.fixture
def reference(flightid: CommandLine, tmp_path: Path) -> dict[str, Any]:
    """Parameters of the record that most cases hold, as a table of blanks."""
    return dict(
        identified(flightid, tmp_path / "reference", "text-forms/blank.asc", "--model", "rigid")[
            "parameters"
        ]
    )


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(name, id=name.replace("/", "-")) for name in SAME])
def test_one_record_in_every_form_gives_one_answer(
    flightid: CommandLine, tmp_path: Path, reference: dict[str, Any], name: str
) -> None:
    channels, options = SAME[name]
    if channels:
        (tmp_path / "map.toml").write_text(channels)
        options = [*options, "--channels", str(tmp_path / "map.toml")]
    found = identified(flightid, tmp_path / "out", name, "--model", "rigid", *options)["parameters"]
    for each in BOMBER:
        assert found[each]["estimate"] == pytest.approx(
            reference[each]["estimate"], abs=1e-3 * reference[each]["std"]
        ), each


def test_two_servos_are_one_elevator(flightid: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(ELEVONS)
    found = identified(
        flightid,
        tmp_path / "out",
        "mixed-surfaces/elevons.csv",
        "--model",
        "rigid",
        "--channels",
        tmp_path / "map.toml",
    )
    assert found["parameters"]["Cm_de"]["estimate"] == pytest.approx(-2.58, abs=0.03)


@pytest.mark.parametrize(("name", "unit"), [("coast_feet", "ft"), ("fall_km", "km")])
def test_a_height_in_another_unit_is_named(flightid: CommandLine, name: str, unit: str) -> None:
    path = CASES / "altitude-units" / f"{name}.csv"
    said = flightid.refused("identify", path, "--model", "ballistic")
    assert f"is in {unit}, not in m" in said


def test_a_height_in_its_unit_gives_the_truth(flightid: CommandLine, tmp_path: Path) -> None:
    for name, unit in (("coast_feet", "ft"), ("fall_km", "km")):
        (tmp_path / "map.toml").write_text(f'altitude = {{column = "altitude", unit = "{unit}"}}\n')
        options = ["--model", "ballistic", "--channels", tmp_path / "map.toml"]
        found = identified(flightid, tmp_path / name, f"altitude-units/{name}.csv", *options)[
            "parameters"
        ]["beta"]
        assert abs(found["estimate"] - 120.0) < 4.0 * found["std"] and found["std"] < 10.0


@pytest.mark.long
def test_missing_rows_leave_equation_error_alone(flightid: CommandLine, tmp_path: Path) -> None:
    model = CASES / "equation-error-missing-rows" / "roll_axis.py"
    found = identified(
        flightid,
        tmp_path / "out",
        "equation-error-missing-rows/roll.csv",
        "--model",
        model,
        "--method",
        "equation-error",
    )
    assert found["parameters"]["L_p"]["estimate"] == pytest.approx(-4.0, abs=0.05)
    assert found["parameters"]["L_u"]["estimate"] == pytest.approx(50.0, rel=0.01)


@pytest.mark.long
def test_a_gap_in_time_is_two_records(flightid: CommandLine, tmp_path: Path) -> None:
    found = identified(flightid, tmp_path / "out", "lateral-time-gap/gap.csv", "--model", "lateral")
    assert found["parameters"]["Cl_p"]["estimate"] == pytest.approx(-0.51, abs=0.01)
    assert "used as 2 records" in json.dumps(found)


def test_a_maneuver_is_no_noise(flightid: CommandLine, tmp_path: Path) -> None:
    found = identified(
        flightid, tmp_path / "out", "maneuver-as-noise/small.csv", "--model", "rigid"
    )
    assert "noise that changes" not in json.dumps(found)
    assert found["parameters"]["Cm_de"]["estimate"] == pytest.approx(-1.1, abs=0.1)


def test_times_of_three_digits(flightid: CommandLine, tmp_path: Path) -> None:
    model = CASES / "time-three-digits" / "nomoto.py"
    found = identified(flightid, tmp_path / "out", "time-three-digits/zigzag.csv", "--model", model)
    assert found["parameters"]["K"]["estimate"] == pytest.approx(-0.1, rel=0.02)
    assert "the time stamps have few digits" in json.dumps(found)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["multirate_input", "topics"])
def test_topics_at_several_rates(
    flightid: CommandLine, tmp_path: Path, reference: dict[str, Any], name: str
) -> None:
    content = identified(
        flightid, tmp_path / "out", f"topics-merged/{name}.csv", "--model", "rigid"
    )
    assert "has a sample every" in json.dumps(content)
    # An elevator that is known at 10 Hz alone leaves its instants open by a twentieth of a second.
    for each in ("Cm_alpha", "Cm_de"):
        assert content["parameters"][each]["estimate"] == pytest.approx(
            reference[each]["estimate"], rel=0.1
        ), each
