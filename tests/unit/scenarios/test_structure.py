"""Model structure from files: what is read, printed, written and refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import flightid as fid
from scenarios.export.targets import written_model
from scenarios.files.aircraft_files import read_aircraft, vehicle_file_text
from scenarios.files.declarations import read_toml_source
from scenarios.files.vehicles import with_plain_terms
from scenarios.files.writing import write_record
from scenarios.preparation.plan import Request
from scenarios.structure import (
    FoundStructure,
    StructureOptions,
    coefficients_of,
    hold_of_inputs,
    structure_of,
    structure_of_files,
)
from scenarios.structure_report import (
    coefficient_figure,
    findings,
    structure_text,
    write_structure,
)
from sim.aerodynamics import Term, parents
from sim.declaration.compile import compile_model
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import Aircraft, aircraft_model
from tests.airliner import AIRLINER
from tests.bases import Flight, fly
from tests.unit.ident.structure.test_selection import CURVED, NOISE, clean, term

OPTIONS = StructureOptions()


@cache
def record_of(seed: int) -> Record:
    time, u, rows = clean(seed)
    return noisy(time, u, rows, seed)


def noisy(
    time: np.ndarray, u: np.ndarray, rows: dict[str, np.ndarray], seed: int, more: float = 1.0
) -> Record:
    """A record of a maneuver with the noise of the sensors, ``more`` times ``NOISE``."""
    rng = np.random.default_rng(seed)
    outputs = tuple(
        Channel.of(
            name,
            {"alpha": "rad", "beta": "rad", "airspeed": "m/s"}.get(
                name, "rad/s" if name in "pqr" else "m/s2"
            ),
            rows[name] + more * std * rng.standard_normal(len(time)),
        )
        for name, std in NOISE.items()
    )
    units = {**CURVED.surfaces, "thrust": "N"}
    inputs = tuple(
        Channel.of(name, unit, row) for (name, unit), row in zip(units.items(), u, strict=True)
    )
    return Record(time, inputs, outputs, Hold.PREVIOUS, f"m{seed}.csv")


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    for seed in (1, 2, 3):
        write_record(tmp_path, record_of(seed), f"m{seed}")
    plain = replace(CURVED, coefficients={axis: {Term(): 0.0} for axis in CURVED.coefficients})
    (tmp_path / "vehicle.toml").write_text(vehicle_file_text(plain))
    return [tmp_path / f"m{seed}.csv" for seed in (1, 2, 3)]


@pytest.mark.long
def test_from_files_to_a_vehicle_file_that_reads_back(files: list[Path], tmp_path: Path) -> None:
    found = structure_of_files(Request(tuple(files)), OPTIONS)
    folder = write_structure(found, tmp_path / "terms", figures=("png",))
    aircraft, _ = read_aircraft(read_toml_source(folder / "vehicle.toml"))
    for axis, true in CURVED.coefficients.items():
        values = aircraft.coefficients[axis]
        for each, value in true.items():
            if each.factors and abs(value) > 0.05:
                assert values[each] == pytest.approx(value, rel=0.1)
    assert term("alpha*elevator") in aircraft.coefficients["Cm"]
    content = json.loads((folder / "structure.json").read_text())
    assert content["coefficients"]["Cm"]["r2_left_out"] > 0.97
    assert {each.name for each in folder.iterdir()} >= {"forces.png", "moments.png", "report.html"}
    text = structure_text(found)
    assert "alpha*elevator" in text
    assert "R2 left out" in text


def test_one_maneuver_alone_is_written_without_what_is_left_out(
    files: list[Path], tmp_path: Path
) -> None:
    found = structure_of_files(Request((files[0],)), OPTIONS)
    folder = write_structure(found, tmp_path / "one", figures=())
    content = json.loads((folder / "structure.json").read_text())
    cm = content["coefficients"]["Cm"]
    assert cm["steps"] and "r2_left_out" not in cm and "r2_left_out" not in cm["steps"][0]


def test_surfaces_that_move_together_are_named() -> None:
    record = record_of(1)
    moved = tuple(
        Channel.of("rudder", "rad", 0.5 * record["aileron"].values)
        if each.name == "rudder"
        else each
        for each in record.inputs
    )
    found = structure_of([replace(record, inputs=moved)], CURVED, OPTIONS)
    (line,) = [each for each in findings(found) if "move together" in each]
    assert line.startswith("aileron and rudder") and "1.000" in line
    assert not any("move together" in each for each in findings(structure_of([record], CURVED)))


def test_values_that_hold_at_the_flown_angle_of_attack_alone_are_named() -> None:
    found = structure_of([record_of(1)], CURVED, OPTIONS)
    none = {axis: replace(each, multiples=()) for axis, each in found.collinearity.items()}
    plain = replace(found, collinearity=none)
    assert not any("stays near" in each for each in findings(plain))
    pair = (term("beta"), term("alpha*beta"))
    together = {**none, "Cn": replace(none["Cn"], multiples=(pair,))}
    (line,) = set(findings(replace(plain, collinearity=together))) - set(findings(plain))
    mean = float(np.degrees(np.mean(found.histories[0].samples["alpha"])))
    assert line.startswith(f"alpha stays near {mean:.3g} deg while these terms move: Cn beta.")


def test_a_true_baseline_leaves_what_the_sensors_explain() -> None:
    """Noise of angles acts through the baseline's terms, that of rates through an accelerometer far
    from the centre of gravity.
    """
    ahead = replace(CURVED, sensors={**CURVED.sensors, "accelerometer": (4.5, 0.0, 0.5)})
    time, u, _ = clean(1)
    system = compile_model(aircraft_model(ahead))
    rows = dict(zip(system.output_names, fly(system, Flight(time, u, max_step=0.02)), strict=True))
    found = structure_of(
        [noisy(time, u, rows, 5, more=4.0)], ahead, StructureOptions(baseline=True)
    )
    assert not any("lacks" in each for each in findings(found))
    for axis, each in found.selections.items():
        assert 0.8 < each.ratio < 1.25, axis


@pytest.mark.long
def test_increments_to_a_baseline_are_what_it_lacks() -> None:
    found = structure_of(
        [record_of(1), record_of(2)], AIRLINER, StructureOptions(degree=2, baseline=True)
    )
    (step, *_) = found.selections["Cm"].steps
    assert step.term == term("alpha*elevator")
    assert found.aircraft.coefficients["Cm"][term("alpha*elevator")] == pytest.approx(4.0, rel=0.1)
    assert found.aircraft.coefficients["Cm"][term("q")] == pytest.approx(-20.0, rel=0.05)
    assert found.sigmas["Cm_alpha_elevator"] > 0.0


def test_a_term_that_is_not_offered_is_named(tmp_path: Path) -> None:
    path = tmp_path / "terms.toml"
    plain = '["alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder", "alpha^2"]'
    axes = ("CD", "CY", "CL", "Cl", "Cm", "Cn")
    path.write_text("".join(f"{axis} = {plain}\n" for axis in axes))
    found = structure_of([record_of(1), record_of(2)], CURVED, StructureOptions(terms=path))
    told = findings(found)
    assert any(line.startswith("Cm lacks terms") and "alpha*elevator" in line for line in told)
    assert any(line.startswith("Cl lacks terms") and "alpha*beta" in line for line in told)
    assert not any(line.startswith("Cn lacks") for line in told)


def test_splines_are_offered_where_they_are_asked_for() -> None:
    found = structure_of([record_of(1)], CURVED, StructureOptions(splines=2, degree=1))
    used = {each.text for s in found.selections.values() for each in s.terms}
    assert all(np.isnan(each.held_out) for each in found.selections.values())
    assert "elevator" in used


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('Cm = ["alfa"]', "unknown signal alfa"),
        ('Cm = "alpha"', "no list of terms"),
        ('CZ = ["alpha"]', "no coefficient CZ"),
        ('Cmm = ["alpha"]', "no coefficient Cmm"),
    ],
)
def test_a_wrong_file_of_terms_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "terms.toml"
    path.write_text(text)
    with pytest.raises(DeclarationError, match=line):
        structure_of([record_of(1)], CURVED, StructureOptions(terms=path))


@pytest.mark.parametrize(
    "wrong",
    [{"method": "lasso"}, {"bandwidth": 0.0}, {"bandwidth": np.nan}, {"degree": 0}, {"splines": 9}],
)
def test_wrong_options_are_one_line(wrong: dict[str, float]) -> None:
    with pytest.raises(DeclarationError):
        StructureOptions(**wrong)  # type: ignore[arg-type]


def test_a_missing_channel_is_one_line() -> None:
    record = record_of(1)
    with pytest.raises(RecordError, match="it has no beta"):
        coefficients_of(record.only(name for name in record.output_names if name != "beta"), CURVED)
    without = Record(record.time, record.inputs[:-1], record.outputs, record.hold, record.name)
    with pytest.raises(RecordError, match="it has no thrust"):
        coefficients_of(without, CURVED)


def test_still_records_are_refused() -> None:
    record = record_of(1)

    def at_rest(each: Channel) -> Channel:
        return Channel.of(each.name, each.unit, np.full(len(record), each.values[0]))

    still = Record(
        record.time,
        tuple(map(at_rest, record.inputs)),
        tuple(map(at_rest, record.outputs)),
        record.hold,
        record.name,
    )
    with pytest.raises(RecordError, match="no signal moves"):
        structure_of([still], CURVED)


def test_a_vehicle_file_needs_no_terms(tmp_path: Path) -> None:
    text = vehicle_file_text(CURVED)
    path = tmp_path / "vehicle.toml"
    path.write_text(text[: text.index("[aerodynamics")])
    aircraft, _ = read_aircraft(with_plain_terms(read_toml_source(path)))
    assert isinstance(aircraft, Aircraft)
    assert aircraft.forces == ("CX", "CY", "CZ")
    assert aircraft.coefficients["Cm"] == {Term(): 0.0}


@pytest.mark.long
def test_in_python_as_by_the_command(files: list[Path], tmp_path: Path) -> None:
    found = fid.structure(files, files[0].parent / "vehicle.toml")
    command = structure_of_files(Request(tuple(files)), OPTIONS)
    assert found.terms.keys() == command.aircraft.coefficients.keys()
    frame = found.to_dataframe()
    assert frame.loc["Cm_alpha", "value"] == found.terms["Cm"]["alpha"]
    assert frame["std"].min() > 0.0
    assert min(found.r2.values()) > 0.99
    folder = found.save(tmp_path / "terms", figures=False)
    path = fid.export(folder / "vehicle.toml", "jsbsim", tmp_path / "plane.xml")
    assert "<fdm_config" in path.read_text()
    assert repr(found).startswith("<Structure of") and "Cm" in found.summary()
    with pytest.raises(fid.InputError, match="method="):
        fid.structure(files, files[0].parent / "vehicle.toml", method="guess")
    with pytest.raises(fid.InputError, match="there is no target"):
        fid.export(folder / "vehicle.toml", "paper", tmp_path / "plane.txt")


def test_panels_name_their_records_and_the_title_how_many_are_shown() -> None:
    found = structure_of([record_of(1), record_of(2)], CURVED, OPTIONS)
    shown = coefficient_figure(found, ("Cl", "Cm"))
    heads = [panel.get_title(loc="left") for panel in shown.axes]
    assert heads == ["m1.csv", "m2.csv", "", ""]
    fewer = coefficient_figure(found, ("Cl",), most=1)
    told = " ".join(text.get_text() for text in fewer.texts)
    assert "the first 1 of 2 records" in told


def test_products_come_after_their_linear_terms_where_it_is_asked_for() -> None:
    options = StructureOptions(hierarchical=True)
    found = structure_of([record_of(1), record_of(2)], CURVED, options)
    assert "stepwise regression, hierarchical" in structure_text(found)
    assert term("alpha*elevator") in found.aircraft.coefficients["Cm"]
    for axis, terms in found.aircraft.coefficients.items():
        offered = {t for t in terms if len(t.factors) == 1}
        assert all(parents(each) <= offered for each in terms), axis
    with pytest.raises(DeclarationError, match="--hierarchical"):
        StructureOptions(method="orthogonal", hierarchical=True)


def test_the_summary_says_terms_fit_and_noise() -> None:
    """Oracle: numbers of the selections, collected by hand."""
    found = structure_of([record_of(1), record_of(2)], CURVED, StructureOptions())
    told = dict(line.split(None, 1) for line in structure_text(found).splitlines()[:5])
    assert told["study"].startswith("m1.csv, m2.csv: 298 windows")
    worst = min(each.r2 for each in found.selections.values())
    assert told["result"] == f"lowest R2 {worst:.4f} ({_axis_of(found, worst)})"
    ratios = sorted(each.ratio for each in found.selections.values())
    assert told["residual"] == f"{ratios[0]:.2f} to {ratios[-1]:.2f} times the noise"
    lacking = [axis for axis, each in found.selections.items() if each.lacking]
    assert told["outcome"].startswith("terms are missing in" if lacking else "terms found: CD ")


def _axis_of(found: FoundStructure, r2: float) -> str:
    return next(axis for axis, each in found.selections.items() if each.r2 == r2)


def test_what_is_found_is_exported_from_its_folder(files: list[Path], tmp_path: Path) -> None:
    found = structure_of_files(Request(tuple(files[:1])), StructureOptions(hierarchical=True))
    folder = write_structure(found, tmp_path / "terms", figures=())
    module, model, _ = written_model(folder, "python", tmp_path / "m.py", None)
    assert model.name == CURVED.name
    parameters = found.aircraft.terms
    assert set(parameters) <= set(re.findall(r"\w+", module.read_text()))


def test_a_term_that_others_depend_on_is_told() -> None:
    found = structure_of([record_of(1)], CURVED, StructureOptions())
    selection = found.selections["CL"]
    assert "is weak" not in structure_text(found).split("CL: ")[-1]
    last = selection.terms[-1]
    weak = replace(selection, confounders=(last,))
    text = " ".join(
        structure_text(replace(found, selections={**found.selections, "CL": weak})).split()
    )
    assert f"CL: {last.text} is weak (F below 20 for coloured residuals). The model keeps" in text


@pytest.mark.parametrize("hold", [Hold.PREVIOUS, Hold.LINEAR])
def test_the_records_decide_how_surfaces_move_between_samples(hold: Hold) -> None:
    time, u, rows = clean(1)
    if hold is Hold.LINEAR:
        system = compile_model(aircraft_model(CURVED))
        flight = Flight(time, u, max_step=0.02, hold=hold)
        rows = dict(zip(system.output_names, fly(system, flight), strict=True))
    record = noisy(time, u, rows, 1)
    found, said = hold_of_inputs([record], CURVED)
    assert found is hold
    word = "held" if hold is Hold.PREVIOUS else "linear"
    assert said and said[0].startswith(f"inputs {word} between samples: linear terms explain")


def test_surfaces_are_read_as_the_records_show_and_the_text_says_so(tmp_path: Path) -> None:
    time, u, _ = clean(1)
    system = compile_model(aircraft_model(CURVED))
    flight = Flight(time, u, max_step=0.02, hold=Hold.LINEAR)
    rows = dict(zip(system.output_names, fly(system, flight), strict=True))
    write_record(tmp_path, noisy(time, u, rows, 1), "m1")
    (tmp_path / "m1.json").unlink()  # it would say how inputs move
    plain = replace(CURVED, coefficients={axis: {Term(): 0.0} for axis in CURVED.coefficients})
    (tmp_path / "vehicle.toml").write_text(vehicle_file_text(plain))
    found = structure_of_files(Request((tmp_path / "m1.csv",)), OPTIONS)
    values = found.selections["Cl"].table
    for each, value in CURVED.coefficients["Cl"].items():
        if each.factors and abs(value) > 0.05:
            assert values[each] == pytest.approx(value, abs=4.0 * found.sigmas[f"Cl_{each.label}"])
    assert "note: inputs linear between samples" in structure_text(found, 400)
