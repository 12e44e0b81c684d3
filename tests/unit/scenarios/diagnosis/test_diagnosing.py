"""From files to the loop: what it is given, and what is refused in one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import flightid as fid
from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.diagnosis.diagnose import Tracing, _peaks, _text, by_hand, diagnose_files
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.diagnosis.opening import candidates_for, read_effects
from scenarios.files.declarations import (
    WANTED,
    ColumnChoice,
    refuse_unknown_attributes,
    run_python,
)
from scenarios.files.measured.columns import RecordFile
from scenarios.files.sources import read_source
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.preparation.declared_model import model_of_file
from scenarios.preparation.plan import Plan, Request, Segment
from sim.declaration.proposal import Traits
from sim.effects.library import effect_modules
from sim.errors import DeclarationError, FlightidError
from sim.record import Channel, Record
from tests.bases import lateral_model
from tests.diagnoses import LOES, RIGID, diagnosis_of, written_inputs

EXAMPLE = Path(__file__).parents[4] / "docs" / "how-to" / "own-effect.md"


class Loop:
    """Stands in for the tracing loop and keeps what it was given."""

    def __init__(self, verdict: Verdict = Verdict.TRACED) -> None:
        self.given: dict[str, Any] = {}
        self.verdict = verdict

    def __call__(
        self,
        records: Sequence[Record],
        model,
        candidates,
        guards,
        validation,
        settings,
        progress,
        kinematics=None,
        reread=None,
    ) -> Diagnosis:
        self.given = {
            "records": records,
            "model": model,
            "candidates": candidates,
            "guards": guards,
            "validation": validation,
        }
        return diagnosis_of(
            self.verdict,
            RIGID if model.equations.name == "rigid" else LOES,
            tuple(records),
            tuple(validation),
        )


def diagnosed(
    records: Sequence[Path],
    model: str,
    vehicle: Path | None = None,
    validate: Sequence[Path] = (),
    effects: Path | None = None,
    plan: Plan | None = None,
    *,
    trace: Loop,
) -> Tracing:
    return diagnose_files(
        Request(tuple(records), model, vehicle, tuple(validate), effects, plan=plan or Plan()),
        trace=trace,
    )


@pytest.fixture(autouse=True)
def checked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the check of the kinematics was asked; it is not run here."""
    asked: list[tuple[Any, ...]] = []

    def check(
        parts: Sequence[tuple[RecordFile, Segment]],
        declared: VehicleFile,
        choices: Mapping[str, ColumnChoice] | None,
        plan: Plan | None,
    ) -> Kinematics:
        asked.append(
            (
                tuple((file.path.name, segment) for file, segment in parts),
                declared.constants["airspeed"],
                choices,
                plan,
            )
        )
        return Kinematics((), None, "not run")

    monkeypatch.setattr("scenarios.diagnosis.diagnose.kinematics_of_files", check)
    return asked


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    return written_inputs(tmp_path)


def loes_files(folder: Path, *headers: str) -> list[Path]:
    """Records of a low-order equivalent with these headers of the stick, and their vehicle file."""
    lines = [f"{key} = {value}" for key, value in LOES.constants.items()] + ["[derivatives]"]
    (folder / "vehicle.toml").write_text(
        "\n".join([*lines, *(f"{key} = {value}" for key, value in LOES.derivatives.items())])
    )
    paths = []
    for number, header in enumerate(headers):
        path = folder / f"r{number}.csv"
        rows = [f"{0.02 * k:.2f},{float(k > 30)},{0.01 * np.sin(k / 9):.6f}" for k in range(100)]
        path.write_text("\n".join([f"time,{header},q", *rows]))
        paths.append(path)
    return paths


def test_loop_gets_biased_model_candidates_and_both_records(files: tuple[Path, Path, Path]) -> None:
    train, validate, vehicle = files
    loop = Loop()
    tracing = diagnosed([train], "rigid", vehicle, [validate], trace=loop)
    model = loop.given["model"]
    assert model.biases == ("alpha", "q", "nz") and not model.noise.measurement_std
    assert [record.name for record in loop.given["records"]] == ["train.csv"]
    assert [record.name for record in loop.given["validation"]] == ["validate.csv"]
    names = {effect.name for effect in loop.given["candidates"]}
    assert {
        "input-delay",
        "sensor-lag:alpha",
        "gust-discrete",
    } <= names and "drag-jump" not in names
    assert not names & {guard.name for guard in loop.given["guards"]}
    assert tracing.held_out_from is None and [file.name for file in tracing.inputs.validation] == [
        "validate.csv"
    ]
    assert tracing.explanations["input-delay"]


def test_kinematics_are_asked_of_all_that_may_choose_where_a_verdict_needs_evidence(
    files: tuple[Path, Path, Path], checked: list[tuple[Any, ...]]
) -> None:
    train, validate, vehicle = files
    assert (
        diagnosed([train], "rigid", vehicle, [validate], trace=Loop(Verdict.CONSISTENT)).kinematics
        is None
        and not checked
    )
    told = diagnosed([train], "rigid", vehicle, [validate], trace=Loop(Verdict.PARTIAL))
    assert told.kinematics is not None and told.kinematics.why == "not run"
    assert checked == [
        (
            (("train.csv", Segment()), ("validate.csv", Segment())),
            RIGID.constants["airspeed"],
            None,
            Plan(),
        )
    ]


def test_kinematics_do_not_see_what_is_held_out(
    files: tuple[Path, Path, Path], checked: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    """Two records or more are fitted here, and they alone are checked."""
    train, validate, vehicle = files
    third = tmp_path / "third.csv"
    third.write_bytes(train.read_bytes())
    diagnosed([train, third], "rigid", vehicle, [validate], trace=Loop(Verdict.PARTIAL))
    assert checked.pop()[0] == (("train.csv", Segment()), ("third.csv", Segment()))
    diagnosed([train, third, validate], "rigid", vehicle, trace=Loop(Verdict.PARTIAL))
    assert checked.pop()[0] == (("train.csv", Segment()), ("third.csv", Segment()))
    plan = Plan((Segment(0.1, 1.4), Segment(1.5, 2.6), Segment(2.7, 3.9)))
    told = diagnosed([train], "rigid", vehicle, plan=plan, trace=Loop(Verdict.PARTIAL))
    assert told.held_out_from is None and checked.pop()[0] == (
        ("train.csv", plan.segments[0]),
        ("train.csv", plan.segments[1]),
    )


def test_window_cuts_the_fitted_records_only(files: tuple[Path, Path, Path]) -> None:
    train, validate, vehicle = files
    loop = Loop()
    diagnosed([train], "rigid", vehicle, [validate], plan=Plan((Segment(1.0, 3.0),)), trace=loop)
    assert (loop.given["records"][0].time[0], loop.given["records"][0].time[-1]) == (1.0, 3.0)
    assert len(loop.given["validation"][0]) == 200


def test_last_part_of_a_single_record_is_held_out(files: tuple[Path, Path, Path]) -> None:
    loop = Loop()
    tracing = diagnosed([files[0]], "rigid", files[2], trace=loop)
    (first,), (held,) = loop.given["records"], loop.given["validation"]
    assert len(first) + len(held) == 200
    assert tracing.held_out_from == held.time[0] > first.time[-1]
    assert tracing.inputs.validation == () and len(tracing.inputs.records) == 1
    assert (
        f"the last part of train.csv, from {held.time[0]:g} s on, is not fitted but predicted"
        in tracing.notes[0]
    )


def test_the_last_of_several_records_is_held_out_whole(files: tuple[Path, Path, Path]) -> None:
    train, validate, vehicle = files
    loop = Loop()
    tracing = diagnosed([train, validate], "rigid", vehicle, trace=loop)
    (first,), (held,) = loop.given["records"], loop.given["validation"]
    assert (first.name, len(first), held.name, len(held)) == ("train.csv", 200, "validate.csv", 200)
    assert (
        tracing.held_out_from is None
        and "the last record, validate.csv, is not fitted but predicted whole" in tracing.notes[0]
    )
    assert [
        [file.name for file in some] for some in (tracing.inputs.records, tracing.inputs.validation)
    ] == [["train.csv"], ["validate.csv"]]
    # both parts of one file: it is fitted and predicted
    segments = Plan((Segment(0.5, 2.6), Segment(2.7, 3.9)))
    parts = diagnosed([train], "rigid", vehicle, plan=segments, trace=loop)
    assert [record.name for record in parts.validation] == [
        "train.csv[2.7-3.9 s]"
    ] and parts.held_out_from is None
    assert parts.inputs.validation == () and len(parts.inputs.records) == 1


def test_a_record_that_the_others_do_not_cover_is_cut(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    train, validate, vehicle = files
    lean = tmp_path / "lean.csv"
    # no q, no nz
    lean.write_text(
        "\n".join(",".join(line.split(",")[:3]) for line in train.read_text().splitlines())
    )
    still = tmp_path / "still.csv"
    rows = [line.split(",") for line in train.read_text().splitlines()]
    still.write_text(
        "\n".join(
            ",".join([row[0], row[1] if k == 0 else "0", *row[2:]]) for k, row in enumerate(rows)
        )
    )
    for other in (lean, still):
        tracing = diagnosed([other, validate], "rigid", vehicle, trace=Loop())
        assert tracing.held_out_from is not None and len(tracing.records) == 2, other
    short = Plan((Segment(0.0, 0.6), Segment(0.7, 3.9)))  # too little would remain to be fitted
    assert diagnosed([train], "rigid", vehicle, plan=short, trace=Loop()).held_out_from is not None


def test_what_says_nothing_is_no_validation(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    train, _, vehicle = files
    rows = train.read_text().splitlines()
    poor = {
        "five": (
            rows[:6],
            r"five\.csv \(--validate\): 5 rows with 1[0-5] samples are too few to predict: 2 "
            r"initial states and 3 biases",
        ),
        "stuck": (
            [rows[0], *(f"{row.split(',')[0]},0,0.1,0,1" for row in rows[1:])],
            "all samples of alpha and q and nz are the same",
        ),
    }
    rng = np.random.default_rng(0)
    rest = [
        f"{0.02 * k:.2f},0," + ",".join(f"{value:.5f}" for value in 0.001 * rng.standard_normal(3))
        for k in range(200)
    ]
    poor["rest"] = ([rows[0], *rest], "no channel moves above its noise")
    for name, (lines, said) in poor.items():
        (tmp_path / f"{name}.csv").write_text("\n".join(lines))
        with pytest.raises(FlightidError, match=said) as caught:
            diagnosed([train], "rigid", vehicle, [tmp_path / f"{name}.csv"], trace=Loop())
        assert "name a longer record with a maneuver" in str(caught.value)


def test_vehicle_file_beside_the_record_serves(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    train, _, vehicle = files
    assert diagnosed([train], "rigid", trace=Loop()).inputs.vehicle.name == "vehicle.toml"
    vehicle.unlink()
    with pytest.raises(
        FlightidError, match=r"--vehicle: the rigid model needs .*vehicle\.toml beside train\.csv"
    ):
        diagnosed([train], "rigid", trace=Loop())


def test_delay_and_lag_of_the_equivalent_model_are_no_candidates(tmp_path: Path) -> None:
    loop = Loop()
    diagnosed(loes_files(tmp_path, "stick [in]"), "loes", trace=loop)
    names = {effect.name for effect in loop.given["candidates"]}
    assert not names & {"input-delay", "actuator-lag"} and "input-deadband" in names
    assert loop.given["model"].biases == ("q",)


def test_sticks_of_two_units_do_not_meet(tmp_path: Path) -> None:
    paths = loes_files(tmp_path, "stick [in]", "stick [in]", "stick_cm", "stick")
    assert diagnosed(paths[:2], "loes", trace=Loop()).stick_unit == "in"
    with pytest.raises(
        FlightidError, match=r"r2\.csv: the stick is in 'cm', in r0\.csv it is in 'in'"
    ):
        diagnosed(paths[:1], "loes", validate=[paths[2]], trace=Loop())
    with pytest.raises(FlightidError, match=r"r3\.csv: the stick is in no unit"):
        diagnosed([paths[0], paths[3]], "loes", trace=Loop())


def test_wrong_calls_are_refused_in_one_line(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    train, _, vehicle = files
    with pytest.raises(FlightidError, match=r"--model: there is no model 'rigide'"):
        diagnosed([train], "rigide", vehicle, trace=Loop())
    with pytest.raises(FlightidError, match="named twice"):
        diagnosed([train], "rigid", vehicle, [tmp_path / "." / "train.csv"], trace=Loop())
    lean = tmp_path / "lean.csv"
    lean.write_text("time,elevator,nz\n" + "\n".join(f"{0.02 * k},0,1" for k in range(50)))
    other = tmp_path / "other.csv"
    other.write_text(
        "time,elevator,q\n" + "\n".join(f"{0.02 * k},0,{0.001 * k}" for k in range(50))
    )
    with pytest.raises(FlightidError, match=r"other\.csv: none of the fitted channels \(nz\)"):
        diagnosed([lean], "rigid", vehicle, [other], trace=Loop())


def test_three_samples_are_too_few_and_no_fault_of_the_elevator(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    train, validate, vehicle = files
    short = tmp_path / "short.csv"
    short.write_text("\n".join(train.read_text().splitlines()[:4]) + "\n")
    with pytest.raises(FlightidError, match=r"short\.csv: 3 rows with \d+ samples .* too few"):
        diagnosed([short], "rigid", vehicle, [validate], trace=Loop())
    with pytest.raises(FlightidError, match=r"short\.csv: 3 rows with \d+ samples .* too few"):
        fid.identify(short, "rigid", vehicle)


def example() -> str:
    return EXAMPLE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]


def test_documented_effect_joins_the_candidates(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    train, validate, vehicle = files
    own = tmp_path / "my_effects.py"
    own.write_text(example())
    loop = Loop()
    tracing = diagnosed([train], "rigid", vehicle, [validate], own, trace=loop)
    assert loop.given["candidates"][-1].name == "vane-upwash"
    assert tracing.inputs.effects[0].name == "my_effects.py"
    assert (
        "{upwash}" in tracing.traits["vane-upwash"].sentences[0]
        and tracing.explanations["vane-upwash"]
    )
    model = model_of_file(read_vehicle(vehicle, "rigid"))
    assert "vane-upwash" not in {effect.name for effect in candidates_for(model)}, (
        "a user's effect must not stay behind"
    )


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("x = 1", "it offers no effect; define EFFECTS"),
        ("EFFECTS = ()", "it offers no effect; define EFFECTS"),
        (
            "\n\nimport nothing_of_that_name",
            "line 3: ModuleNotFoundError: No module named 'nothing_of_that_name'",
        ),
        ("def f(:", "line 1: SyntaxError: invalid syntax"),
        ("EFFECTS = [1]", "1 is a int, not an effect"),
        (
            "from sim.effects.library import find_effect\nEFFECTS = [find_effect('input-delay')]",
            "the library has one of this name",
        ),
        ("class A:\n    name = 'a'\nEFFECTS = [A]", "A is a class; put an instance"),
        (None, "there is no such file"),
    ],
)
def test_faults_of_a_users_file_are_told_in_one_line(
    content: str | None, line: str, files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    own = tmp_path / "mine.py"
    if content is not None:
        own.write_text(content)
    model = model_of_file(read_vehicle(files[2], "rigid"))
    with pytest.raises(FlightidError) as caught:
        read_effects(own, model)
    assert (
        line in str(caught.value)
        and str(caught.value).startswith(str(own))
        and "\n" not in str(caught.value)
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '    channel = "alpha"\n',
            '    channel = "alpha"\n    rank = 30\n',
            "effect vane-upwash: unknown attribute 'rank'; its present name is 'path_order'",
        ),
        (
            '    channel = "alpha"\n',
            '    channel = "alpha"\n    rank: int = 30\n\n    def place(self):\n'
            "        return self.rank\n",
            "effect vane-upwash: unknown attribute 'rank'; its present name is 'path_order'",
        ),
        (
            "Regularity.REGULAR",
            "Regularity.UNDEFINED",
            ", line 22: Regularity has no attribute 'UNDEFINED'; "
            "its present name is 'UNIDENTIFIED_AT_ABSENCE'",
        ),
        (
            "Regularity.REGULAR",
            "Regularity.REGULER",
            ", line 22: Regularity has no attribute 'REGULER'; did you mean 'REGULAR'?",
        ),
        (
            '    channel = "alpha"\n',
            '    channel = "alpha"\n    path_ordr = 30\n',
            "effect vane-upwash: unknown attribute 'path_ordr'; did you mean 'path_order'?",
        ),
        (
            '    channel = "alpha"\n',
            '    channel = "alpha"\n    colour = "red"\n',
            "effect vane-upwash: unknown attribute 'colour'; leave it out, nothing reads it",
        ),
    ],
)
def test_an_attribute_that_no_effect_has_is_refused_with_the_name_that_is_meant(
    old: str, new: str, message: str, files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    own = tmp_path / "mine.py"
    own.write_text(example().replace(old, new))
    with pytest.raises(FlightidError) as caught:
        read_effects(own, model_of_file(read_vehicle(files[2], "rigid")))
    assert str(caught.value).startswith(str(own)) and str(caught.value).endswith(message)
    assert "\n" not in str(caught.value)


def test_attributes_that_the_users_file_reads_itself_are_allowed(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    own = tmp_path / "mine.py"
    text = example().replace(
        '    channel = "alpha"\n',
        '    channel = "alpha"\n    limit = 5.0\n    share: float = 1.0\n',
    )
    text = text.replace("(-5.0, 5.0)", "(-limit, limit)").replace(
        "p.upwash * s", "self.share * p.upwash * s"
    )
    own.write_text(text)
    (effect,) = read_effects(own, model_of_file(read_vehicle(files[2], "rigid")))
    assert effect.parameters[0].bounds == (-5.0, 5.0)


@pytest.mark.parametrize("module", effect_modules(), ids=lambda module: module.__name__)
def test_no_attribute_of_an_effect_in_the_library_would_be_refused(module: ModuleType) -> None:
    source = read_source(str(module.__file__), DeclarationError, WANTED)
    for effect in run_python(source, "effects").VARIANTS:
        refuse_unknown_attributes(effect, source.content, "library")


def test_effects_for_other_vehicles_are_left_out_or_refused(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    model = model_of_file(read_vehicle(files[2], "rigid"))
    own = tmp_path / "mine.py"
    elsewhere = example().replace('channel = "alpha"', 'channel = "altitude"')
    own.write_text(elsewhere)
    with pytest.raises(
        FlightidError,
        match=(
            r"no effect of it \(vane-upwash\) can act on the rigid model; its inputs are elevator"
        ),
    ):
        read_effects(own, model)
    own.write_text(
        example().replace("EFFECTS = (VaneUpwash(),)", "EFFECTS = (VaneUpwash(), VaneUpwash())")
    )
    with pytest.raises(FlightidError, match="vane-upwash is there twice"):
        read_effects(own, model)


def test_an_effect_file_of_the_former_form_is_read_as_before(
    files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    text = example()
    new, rest = text.split("    traits = Traits(\n")[0], text.split("    explanation")[1]
    former = (
        '    plausible = {"upwash": (-1.0, 1.0)}\n    onset = ""\n    per_record = True\n    '
        'sentence = "turned by {upwash}"\n'
    )
    own = tmp_path / "former.py"
    own.write_text(f"{new}{former}    explanation{rest}")
    (effect,) = read_effects(own, model_of_file(read_vehicle(files[2], "rigid")))
    assert effect.traits == Traits(
        ("turned by {upwash}",), plausible={"upwash": (-1.0, 1.0)}, per_record=True
    )
    own.write_text(f"{new}    explanation{rest}")
    with pytest.raises(FlightidError, match="effect vane-upwash lacks traits"):
        read_effects(own, model_of_file(read_vehicle(files[2], "rigid")))
    own.write_text(f"{new}    traits = {{}}\n    explanation{rest}")
    with pytest.raises(FlightidError, match="its traits are of type dict"):
        read_effects(own, model_of_file(read_vehicle(files[2], "rigid")))


TIME = 0.1 * np.arange(50)


def record_of(**inputs: float) -> Record:
    """Inputs that begin at 0.3 and move by these to one side, less to the other."""
    wave = np.sin(TIME) * np.where(np.sin(TIME) > 0.0, 1.0, 0.4) / np.max(np.sin(TIME))
    channels = tuple(Channel.of(name, "rad", 0.3 + size * wave) for name, size in inputs.items())
    return Record(TIME, channels, (Channel.of("p", "rad/s", np.zeros(50)),))


def test_a_peak_is_the_largest_excursion_from_the_first_sample_over_all_records() -> None:
    found = _peaks(
        lateral_model(), [record_of(aileron=0.05), record_of(aileron=-0.08, rudder=0.02)]
    )
    assert found == {"aileron": pytest.approx(0.08), "rudder": pytest.approx(0.02)}
    assert _peaks(lateral_model(), [record_of(rudder=0.02)]) == {"rudder": pytest.approx(0.02)}


def test_numbers_are_asked_with_four_digits() -> None:
    assert _text("Cm_alpha", -0.123456) == "Cm_alpha=-0.1235"


def test_ramps_are_flown_by_hand_and_steps_between_samples_are_not() -> None:
    time = 0.02 * np.arange(200)

    def flown(rise: float) -> list[Record]:
        wave = np.clip((time - 1.0) / rise, 0.0, 1.0)
        channel = Channel.of("aileron", "rad", 0.05 * wave)
        return [Record(time, (channel,), (Channel.of("p", "rad/s", np.zeros(200)),))]

    model = lateral_model()
    assert by_hand(model, flown(0.2)) and not by_hand(model, flown(0.02))
    assert not by_hand(model, [*flown(0.2), *flown(0.02)])
