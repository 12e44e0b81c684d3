"""Files and arguments made to break a reader, and models that end the program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scenarios.cli.application import report_error
from scenarios.files.declarations import run_python
from scenarios.files.sources import (
    DEEPEST_NESTING,
    DocumentError,
    json_value,
    read_source,
    toml_value,
)
from scenarios.files.units import to_si
from sim.errors import DeclarationError, RecordError
from tests.integration.command_line import VEHICLE, CommandLine, contents

DEEP = 10_000
DIGITS = "7" * 5000
RED = "\x1b[31mred\x07"
MODEL = """
from sim.declaration import own_model

calls = [0]

def rates(s, p):
    calls[0] += 1
    if calls[0] > {after}:
        {late}
    return {{"p": p.L_p * s.p + p.L_da * s.aileron}}

MODEL = own_model(
    name="roll", states={{"p": "rad/s"}}, inputs={{"aileron": "rad"}}, outputs={{"p": "rad/s"}},
    parameters={{"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")}}, rates=rates,
    readings=lambda s, p: {{"p": s.p}},
)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short record, a vehicle file, a user's model, and a study of each kind that commands
    read.
    """
    from scenarios.cli import main

    folder = tmp_path_factory.mktemp("made")
    (folder / "plane.toml").write_text(VEHICLE)
    (folder / "roll.py").write_text(MODEL.format(after=10**9, late="pass"))
    flight, vehicle = str(folder / "flight.csv"), str(folder / "plane.toml")
    fit = ["--model", "rigid", "--vehicle", vehicle, "--figures", "none", "--quiet"]
    calls = [
        [
            "simulate",
            "rigid",
            "--out",
            flight,
            "--set",
            "flight.duration=6",
            "--set",
            "flight.rate=25",
            "--quiet",
        ],
        ["identify", flight, "--out", str(folder / "fit"), *fit],
        [
            "simulate",
            "--model",
            str(folder / "roll.py"),
            "--out",
            str(folder / "roll.csv"),
            "--duration",
            "8",
            "--rate",
            "25",
            "--quiet",
        ],
    ]
    for call in calls:
        with pytest.raises(SystemExit) as ended:
            main(call)
        assert ended.value.code == 0
    return folder


@pytest.fixture
def place(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of what was made, the current folder."""
    import shutil

    shutil.copytree(made, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


IDENTIFY = (
    "identify",
    "flight.csv",
    "--model",
    "rigid",
    "--vehicle",
    "plane.toml",
    "--method",
    "equation-error",
)


@pytest.mark.parametrize(
    "text",
    ["[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, "[" * 100 + "]" * 100],
)
def test_json_that_is_nested_too_deeply(text: str) -> None:
    with pytest.raises(DocumentError):
        json_value(text)


@pytest.mark.parametrize(
    "text", ["NaN", "[Infinity]", '{"a": -1e999}', DIGITS, "1" + "0" * 300, "[1,]", "", "\xff"]
)
def test_json_that_is_not_strict(text: str) -> None:
    with pytest.raises(DocumentError):
        json_value(text.encode("latin-1"))


def test_what_every_file_of_ours_may_hold_is_read() -> None:
    deep = json.loads("[" * DEEPEST_NESTING + "]" * DEEPEST_NESTING)
    assert json_value("[" * DEEPEST_NESTING + "]" * DEEPEST_NESTING) == deep
    assert json_value('{"a": [1, -2.5, "x", null, true]}') == {"a": [1, -2.5, "x", None, True]}
    assert json_value(str(10**299)) == 10**299
    assert toml_value("a = inf\nb = -3\nc = {d = [1, 2]}") == {
        "a": float("inf"),
        "b": -3,
        "c": {"d": [1, 2]},
    }


@pytest.mark.sampled
@pytest.mark.parametrize(
    "value",
    [
        "[" * DEEP + "]" * DEEP,
        "{a=" * DEEP + "1" + "}" * DEEP,
        DIGITS,
        "0x" + "f" * 300,
        "[" * 100 + "]" * 100,
    ],
)
@pytest.mark.parametrize(
    "file", ["plane.toml", "channels.toml", "limits.toml", "flights.toml", "scenario.toml"]
)
def test_toml_that_is_deep_or_long_is_one_line_in_every_file(
    flightid: CommandLine, place: Path, file: str, value: str
) -> None:
    (place / file).write_text(f"mass = {value}\n")
    plan = ("design", "--model", "rigid", "--vehicle")
    calls = {
        "plane.toml": IDENTIFY,
        "channels.toml": (*IDENTIFY, "--channels", file),
        "limits.toml": (*plan, "plane.toml", "--limits", file),
        "flights.toml": ("survey", file, "--out", "morning"),
        "scenario.toml": ("run", file),
    }
    assert file in flightid.refused(*calls[file])


@pytest.mark.sampled
@pytest.mark.parametrize("value", ["[" * DEEP, "NaN", DIGITS, '{"a":' * DEEP])
@pytest.mark.parametrize(
    ("file", "call"),
    [
        ("report.json", ("report", "fit")),
        ("model.json", ("predict", "fit", "flight.csv")),
        ("comparison.json", ("compare", "fit", "fit")),
        (
            "comparison.json",
            ("watch", "flight.csv", "--model", "loes", "--until-end", "--reference", "fit"),
        ),
    ],
)
def test_a_spoiled_file_of_a_study_is_one_line(
    flightid: CommandLine, place: Path, file: str, call: tuple[str, ...], value: str
) -> None:
    content = json.loads((place / "fit" / file).read_text())
    text = json.dumps({**content, "spoiled": 12345}).replace("12345", value)
    (place / "fit" / file).write_text(text)
    before = contents(place)
    assert f"fit/{file}" in flightid.refused(*call)
    assert contents(place) == before


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"shared": {"CL_alpha": "5.1"}}, "no model"),
        ({"shared": {"CL_alpha": True}}, "no model"),
        ({"settings": {"max_step": "0.01"}}, "no model"),
        ({"settings": {"strange": 1.0}}, "no model"),
        ({"outputs": "alpha"}, "no model"),
        ({"own": {}}, "no model"),
        (
            {"effects": [{"name": "x", "class": "sim.effects.library:EFFECTS", "fields": {}}]},
            "cannot be made again",
        ),
        ({"effects": [{"name": "x", "class": "os:system", "fields": {}}]}, "cannot be made again"),
    ],
)
def test_values_of_another_type_in_a_kept_model_are_one_line(
    flightid: CommandLine, place: Path, change: dict[str, object], what: str
) -> None:
    path = place / "fit" / "model.json"
    content = json.loads(path.read_text())
    content["after"] |= change
    path.write_text(json.dumps(content))
    assert what in flightid.refused("predict", "fit", "flight.csv")


@pytest.mark.parametrize(
    "drawing",
    [
        "<script>alert(1)</script>",
        "<svg ><script>alert(1)</script></svg>",
        '<svg onload="alert(1)"></svg>',
        '<svg ><image href="http://far/away.png"/></svg>',
        '<svg ><rect fill="url(http://far/away)"/></svg>',
        '<svg ><use href="http://far/away.svg#one"/></svg>',
        "<svg ></svg><b>more</b>",
    ],
)
def test_a_figure_of_a_foreign_report_that_does_more_than_draw_is_refused(
    flightid: CommandLine, place: Path, drawing: str
) -> None:
    path = place / "fit" / "report.json"
    content = json.loads(path.read_text())
    content["sections"][0]["blocks"] = [{"figure": "one", "svg": drawing, "caption": "a figure"}]
    path.write_text(json.dumps(content))
    assert "no content of a page" in flightid.refused("report", "fit")


def test_html_and_control_characters_in_a_foreign_report_are_shown(
    flightid: CommandLine, place: Path
) -> None:
    path = place / "fit" / "report.json"
    content = json.loads(path.read_text()) | {"title": f"<script>alert(1)</script>{RED}"}
    path.write_text(json.dumps(content))
    flightid.done("report", "fit")
    page = (place / "fit" / "report.html").read_text()
    assert (
        "&lt;script&gt;alert(1)&lt;/script&gt;\\u001b[31mred\\u0007" in page and "\x1b" not in page
    )


@pytest.mark.parametrize(
    "unit",
    [
        "ft**9**9**9",
        "lb**9**9**9",
        "ft^(9^9^9)",
        "m**99999999999999999999",
        "((((9**99)**99)**99)**99)*m",
        "m" * 5000,
        "٣ m",
    ],
)
def test_units_that_explode_are_unknown(flightid: CommandLine, place: Path, unit: str) -> None:
    with pytest.raises(RecordError, match="unknown unit"):
        to_si(1.0, unit, "m", "here")
    (place / "plane.toml").write_text(VEHICLE.replace("288017 lb", f"1 {unit}"))
    assert "key mass" in flightid.refused(*IDENTIFY)


@pytest.mark.parametrize(
    ("unit", "target", "factor"),
    [
        ("(deg/s)^2", "rad2/s2", np.radians(1.0) ** 2),
        ("slug ft2", "kg m2", 1.3558179483314004),
        ("in**2", "m2", 0.0254**2),
    ],
)
def test_units_with_powers_are_converted(unit: str, target: str, factor: float) -> None:
    assert to_si(1.0, unit, target, "here") == pytest.approx(factor, rel=1e-12)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "line", ["mass = 1e-300", 'mass = "1e-300 lb"', "Cm_q = -28e300", "air_density = 1e300"]
)
def test_numbers_that_nothing_can_be_computed_with_are_one_line(
    flightid: CommandLine, place: Path, line: str
) -> None:
    key = line.split(" ")[0]
    lines = [line if each.startswith(key) else each for each in VEHICLE.splitlines()]
    (place / "plane.toml").write_text("\n".join(lines))
    for call in (
        IDENTIFY,
        ("check", "flight.csv", "--vehicle", "plane.toml"),
        ("design", "--model", "rigid", "--vehicle", "plane.toml"),
    ):
        said = flightid.refused(*call)
        assert f"{key}: " in said and "1e-50 to 1e+50" in said


@pytest.mark.sampled
@pytest.mark.parametrize(
    "call",
    [
        ("campaign", "rigid", "--runs", str(10**18)),
        ("campaign", "rigid", "--runs", str(10**400)),
        ("campaign", "rigid", "--runs", "2", "--jobs", str(10**18)),
        ("campaign", "trace-vane", "--runs", str(10**18)),
        (*IDENTIFY, "--rate", "1e-9"),
        (*IDENTIFY, "--rate", "5e-324"),
        (*IDENTIFY, "--rate", "1e308"),
        (*IDENTIFY, "--lowpass", "1e-9"),
        ("simulate", "--model", "roll.py", "--out", "new.csv", "--rate", "1e12"),
        ("simulate", "--model", "roll.py", "--out", "new.csv", "--rate", "1e-9"),
        ("design", "--model", "rigid", "--vehicle", "plane.toml", "--rate", "1e12"),
        ("simulate", "rigid", "--seed", "٣", "--out", "new.csv"),
        ("simulate", "rigid", "--seed", "1_0", "--out", "new.csv"),
        (*IDENTIFY, "--from", "１"),
        ("simulate", "rigid", "--set", "flight.maneuvers.².start=1", "--out", "new.csv"),
        ("design", "--model", "rigid", "--vehicle", "plane.toml", "--noise", "alpha=٣"),
    ],
)
def test_numbers_on_the_command_line_are_bounded_and_plain(
    flightid: CommandLine, place: Path, call: tuple[str, ...]
) -> None:
    before = contents(place)
    flightid.refused(*call)
    assert contents(place) == before


@pytest.mark.parametrize("digits", ["٠١٢٣٤٥٦٧٨٩", "０１２３４５６７８９"])
def test_digits_of_other_scripts_are_refused_by_every_reader(
    flightid: CommandLine, place: Path, digits: str
) -> None:
    foreign = str.maketrans("0123456789", digits)
    text = (place / "flight.csv").read_text().splitlines()
    (place / "foreign.csv").write_text(
        "\n".join([text[0], *(line.translate(foreign) for line in text[1:])])
    )
    assert "row 2" in flightid.refused("check", "foreign.csv", "--vehicle", "plane.toml")
    (place / "plane.toml").write_text(VEHICLE.replace("288017 lb", "288017 lb".translate(foreign)))
    assert "key mass" in flightid.refused(*IDENTIFY)
    (place / "stream.csv").write_text(
        "time,stick,alpha\n" + "".join(f"{k},0,0\n".translate(foreign) for k in range(9))
    )
    call = flightid("watch", "stream.csv", "--model", "loes", "--until-end", "--no-refine")
    assert call.code == 2


@pytest.mark.long
@pytest.mark.parametrize("bad", ["\x1b[31m", "\x07", "\x9b31m", "\u202e", "\x7f"])
def test_control_characters_never_reach_the_terminal(
    flightid: CommandLine, place: Path, bad: str
) -> None:
    name = f"fl{bad}ight.csv"
    (place / name).write_bytes((place / "flight.csv").read_bytes())
    (place / "plane.toml").write_text(
        VEHICLE.replace(
            '"bomber"',
            f'"bom{bad}ber"'.replace("\x1b", "\\u001b")
            .replace("\x07", "\\u0007")
            .replace("\x7f", "\\u007f"),
        )
    )
    shown = f"fl\\u{ord(bad[0]):04x}"
    printed = flightid("identify", name, *IDENTIFY[2:])
    assert printed.code == 0 and bad[0] not in printed.out + printed.err
    assert shown in printed.out or bad == "\x07"  # the console leaves a bell out by itself
    text = flightid.done("identify", name, *IDENTIFY[2:], "--json")
    assert bad[0] not in text and json.loads(text)["scenario"] == "identify"
    (place / "flight.csv").write_text(f"time,elevator,al{bad}pha\n0,0,0\n1,0,0\n")
    said = flightid(*IDENTIFY)
    assert said.code == 2 and bad[0] not in said.err


@pytest.mark.long
def test_a_record_of_thousands_of_columns_is_read(flightid: CommandLine, place: Path) -> None:
    rows = (place / "flight.csv").read_text().splitlines()
    names = [f"further_channel_{k}" for k in range(9000)]
    head = ",".join([rows[0], *names])
    assert len(head) > 131_072
    (place / "wide.csv").write_text(
        "\n".join([head, *(row + ",0" * len(names) for row in rows[1:])])
    )
    plain, wide = (
        flightid.done("identify", name, *IDENTIFY[2:]) for name in ("flight.csv", "wide.csv")
    )
    tables = [
        [line for line in text.splitlines() if line.startswith("  C")] for text in (plain, wide)
    ]
    assert len(tables[0]) >= 6 and tables[0][:6] == tables[1][:6]


@pytest.mark.sampled
@pytest.mark.parametrize("after", [0, 40])
@pytest.mark.parametrize(
    "late",
    [
        "import sys; sys.exit(0)",
        "raise SystemExit",
        "raise KeyboardInterrupt",
        "raise GeneratorExit",
        "raise BaseException('base')",
        "return {'p': __import__('numpy').ones((3, 5, 7))}",
        "return {'p': 'text'}",
        "return {'p': None}",
        "return {}",
        "return None",
    ],
)
def test_a_model_that_ends_the_program_or_changes_its_answers_is_one_line(
    flightid: CommandLine, place: Path, late: str, after: int
) -> None:
    (place / "roll.py").write_text(MODEL.format(after=after, late=late))
    before = contents(place)
    calls = [
        ("identify", "roll.csv", "--model", "roll.py", "--out", "found", "--figures", "none"),
        ("simulate", "--model", "roll.py", "--out", "new.csv"),
    ]
    for call in calls:
        assert "roll" in flightid.refused(*call)
    assert contents(place) == before


@pytest.mark.parametrize(
    "line",
    [
        "import sys; sys.exit(0)",
        "raise KeyboardInterrupt",
        "raise GeneratorExit",
        "raise BaseException('x')",
    ],
)
def test_a_model_file_that_ends_the_program_when_it_is_read_is_one_line(
    flightid: CommandLine, place: Path, line: str
) -> None:
    with (place / "roll.py").open("a") as file:
        file.write(f"\n{line}\n")
    assert "roll.py, line 18" in flightid.refused("models", "roll.py")


def test_a_true_interrupt_inside_a_model_stays_one(flightid: CommandLine, place: Path) -> None:
    (place / "roll.py").write_text(
        MODEL.format(after=40, late="import signal; signal.raise_signal(signal.SIGINT)")
    )
    call = flightid("identify", "roll.csv", "--model", "roll.py")
    assert (call.code, call.err) == (130, "flightid: stopped; nothing was written\n")


@pytest.mark.parametrize("last", ["1e308", "-1e308"])
@pytest.mark.parametrize("method", ["ekf", "output-error", "equation-error"])
def test_a_time_at_the_end_of_the_numbers_is_one_line(
    flightid: CommandLine, place: Path, last: str, method: str
) -> None:
    rows = (place / "flight.csv").read_text().splitlines()
    _, _, rest = rows[-1].partition(",")
    (place / "flight.csv").write_text("\n".join([*rows[:-1], f"{last},{rest}"]))
    assert "time" in flightid.refused(*IDENTIFY[:-1], method)


@pytest.mark.parametrize("late", ["raise SystemExit(0)", "raise GeneratorExit", "1 / 0"])
def test_what_comes_through_a_users_file_is_its_fault(
    place: Path, capsys: pytest.CaptureFixture[str], late: str
) -> None:
    """Effects are called from many places; whichever it was, their file and line are named."""
    (place / "effects.py").write_text(f"def read(s):\n    {late}\n")
    read = run_python(read_source("effects.py", DeclarationError, "a file"), "effects").read
    with pytest.raises(BaseException) as raised:
        read(None)
    assert report_error(raised.value) == 2
    assert capsys.readouterr().err.startswith("flightid: effects.py, line 2: ")
