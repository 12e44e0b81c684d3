"""The examples that the help shows, typed one after the other in an empty folder; and what
`predict` says beside `--validate`.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from ident.tracing.loop import diagnose
from scenarios.cli import app, main
from scenarios.cli.application import COMMANDS, EXAMPLES
from scenarios.cli.options import METHOD_NAMES, OutputOptions, output_options
from scenarios.cli.studies import documents_of
from scenarios.diagnosis import diagnose as on_files
from scenarios.identification.methods import METHODS
from tests.integration.command_line import CommandLine

NAMES = [function.__name__.rstrip("_") for functions in COMMANDS.values() for function in functions]
# take --no-figures, which spares the test their time
DRAWN = ("run", "compare", "identify", "diagnose", "predict", "check")
RECORD = ("--model", "rigid", "--vehicle", "flight_vehicle.toml")


def one_candidate(
    records: Any,
    model: Any,
    candidates: Sequence[Any],
    guards: Any,
    *others: Any,
    kinematics: Any = None,
    reread: Any = None,
) -> Any:
    """The loop with what is hidden as its only candidate: the commands are tried here, not the
    search.
    """
    return diagnose(
        records, model, [each for each in candidates if each.name == "vane-offset"], (), *others
    )


def typed(line: str) -> tuple[object, str, str]:
    """Type a line as in a shell that knows ``>``; exit code and what stood on the two streams."""
    words = shlex.split(line)
    target = words.pop() if ">" in words else None
    arguments = [word for word in words[1:] if word != ">"]
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main([*arguments, *(["--no-figures"] if arguments[0] in DRAWN else [])])
    if target is not None:
        Path(target).write_text(out.getvalue())
    return ended.value.code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder in which all examples have been typed; each ended well and said nothing on
    stderr.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        patch.setattr(on_files, "_loop", lambda _: one_candidate)
        patch.setattr(on_files, "_kinematics", lambda *_: None)
        patch.setattr("scenarios.tasks.study.available_cores", lambda: 1)
        for line in [line for examples in EXAMPLES.values() for line in examples]:
            assert typed(line)[::2] == (0, ""), line
        yield Path.cwd()


def content(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_every_command_has_examples_and_no_other_has() -> None:
    assert {*EXAMPLES} == {*NAMES}
    assert all(
        line.split()[:2] in (["flightid", name], ["flightid", "simulate"])
        for name, lines in EXAMPLES.items()
        for line in lines
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", NAMES)
def test_help_shows_the_examples_as_they_are_typed(
    name: str, flightid: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    text = flightid.done(name, "--help")
    assert [line.strip() for line in text[text.index("Examples:") :].splitlines()[1::2]] == [
        line for line in EXAMPLES[name]
    ]


def test_help_lists_the_commands_by_group(flightid: CommandLine) -> None:
    lines = flightid.done("-h").splitlines()
    assert flightid.done("run", "-h") == flightid.done("run", "--help")
    places = [lines.index(f"{group}:") for group in COMMANDS]
    assert places == sorted(places)
    assert [
        line.split()[0]
        for line in lines[places[0] :]
        if line.startswith("  ") and not line.startswith("   ")
    ] == NAMES


def test_what_the_help_names_without_loading_it_is_what_there_is() -> None:
    assert {*METHOD_NAMES} == {*METHODS}


@pytest.mark.long
def test_the_examples_run(folder: Path) -> None:
    assert content(folder / "fit.json")["schema"] == "flightid/comparison/1"
    campaign = content(folder / "campaign" / "campaign.json")
    assert (campaign["scenario"], campaign["runs"]) == ("ballistic", 20)


@pytest.mark.long
def test_a_diagnosis_predicts_later_what_it_predicted_at_once(folder: Path) -> None:
    found, error = (
        content(folder / "prediction" / "prediction.json"),
        content(folder / "cause" / "diagnosis.json")["error"],
    )
    assert found["effects"] == found["claimed"] == ["vane-offset"]
    page = (folder / "prediction" / "report.html").read_text(encoding="utf-8")
    assert "sensor noise</button>" in page
    for when, key in (("after", "channels"), ("before", "declared")):
        assert {name: each["rms_error"] for name, each in found[key].items()} == error[when]["rmse"]
        assert {name: each["theil"] for name, each in found[key].items()} == error[when]["theil"]
    names = ("prediction/prediction.csv", "cause/validate_prediction.csv")
    later, at_once = (
        list(csv.DictReader((folder / name).read_text().splitlines())) for name in names
    )
    assert [row["predicted_alpha"] for row in later] == [row["after_alpha"] for row in at_once]
    assert [row["declared_q"] for row in later] == [row["before_q"] for row in at_once]


@pytest.mark.long
def test_an_identification_predicts_later_what_it_predicted_at_once(folder: Path) -> None:
    ended = typed(
        f"flightid identify flight.csv {shlex.join(RECORD)} --validate flight_validate.csv --json "
        "--out again"
    )
    (held,) = [each for each in json.loads(ended[1])["records_fitted"] if each["held_out"]]
    assert ended[1] == (folder / "again" / "comparison.json").read_text()
    code, out, err = typed("flightid predict again flight_validate.csv --json")
    assert (code, err) == (0, "") and json.loads(out)["channels"] == held["channels"]
    part = json.loads(typed("flightid predict again flight_validate.csv --from 2 --to 9 --json")[1])
    assert (part["record"]["from"], part["record"]["to"]) == (2.0, 9.0) and part[
        "channels"
    ] != held["channels"]


def test_a_study_that_keeps_no_model_says_what_to_run(folder: Path) -> None:
    (folder / "old").mkdir(exist_ok=True)
    for name, kept, words in (
        (
            "study",
            "comparison.json",
            "identify its record first: flightid identify study/record.csv",
        ),
        ("old", "diagnosis.json", "run flightid diagnose again"),
        ("nowhere", "", "there is no such folder; name the --out folder"),
        ("campaign", "", "there is no study in this folder"),
    ):
        if name == "old":
            (folder / name / kept).write_text((folder / "cause" / kept).read_text())
        code, out, err = typed(f"flightid predict {name} flight_validate.csv")
        assert (code, out, err.count("\n")) == (2, "", 1) and words in err, err


def test_quiet_prints_warnings_alone_and_json_the_document_alone(folder: Path) -> None:
    code, out, err = typed(f"flightid identify flight.csv {shlex.join(RECORD)} --quiet")
    assert (code, out) == (0, "")
    assert err.startswith("flightid: warning: do not use these sigmas") and err.count("\n") == 1
    code, out, err = typed("flightid simulate rigid --json --out named.csv")
    assert (code, err) == (0, "") and json.loads(out)["files"] == ["named.csv", "named.json"]


def test_quiet_tells_the_warnings_of_a_study_on_the_other_stream(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with output_options(
        tmp_path, ("png",), quiet=True, as_json=False, documents=["study.json"]
    ) as told:
        print("a table")
        (tmp_path / "study.json").write_text('{"warnings": ["the vane sticks"]}')
    assert told == OutputOptions(tmp_path, ("png",), progress=False)
    assert capsys.readouterr() == ("", "flightid: warning: the vane sticks\n")


def test_several_studies_are_a_list_of_their_documents(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    documents = documents_of(["rigid", "a/mine.toml"], False)
    with output_options(None, ("png",), quiet=False, as_json=True, documents=documents) as told:
        print("tables")
        assert told.out is not None and not told.figures and told.progress
        for name in documents:
            (told.out / name).parent.mkdir(parents=True)
            (told.out / name).write_text(json.dumps({"of": name}) + "\n")
    assert json.loads(capsys.readouterr().out) == [
        {"of": "rigid/comparison.json"},
        {"of": "mine/comparison.json"},
    ]
    assert not told.out.exists()


def test_version_and_completion(flightid: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy
    import scipy

    assert (
        flightid.done("--version")
        .strip()
        .endswith(f"NumPy {numpy.__version__}, SciPy {scipy.__version__}")
    )
    assert app is not None
    monkeypatch.setenv("_FLIGHTID_COMPLETE", "complete_bash")
    for words, wanted in (
        ("run ballis", "ballistic"),
        ("identify r.csv --model lat", "lateral"),
        ("effects vane", "vane-offset"),
        ("vehicles bomber_r", "bomber_rigid"),
        ("predi", "predict"),
        ("campaign ballis", "ballistic"),
    ):
        monkeypatch.setenv("COMP_WORDS", f"flightid {words}")
        monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
        assert wanted in flightid().out.split()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "rigid", "--sed", "3"), "--seed"),
        (("identify", "r.csv", "--modle", "rigid"), "--model"),
        (("identfy",), "'identify'"),
        (("predict", "fit"), "missing argument 'RECORD'"),
        (("campaign", "x29-simulation", "--runs", "2"), "no campaign of a scenario of kind x29"),
        (
            ("predict", "fit", "r.csv", "--from", "1", "--to", "2", "--from", "3", "--to", "4"),
            "one part of a record",
        ),
    ],
)
def test_what_is_typed_wrong_is_one_line_with_the_nearest(
    arguments: tuple[str, ...], words: str, flightid: CommandLine
) -> None:
    assert words in flightid.refused(*arguments)
