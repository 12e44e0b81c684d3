"""A model written as a Python module and as an FMU flies as it does here."""

from __future__ import annotations

import ctypes
import io
import shutil
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from scenarios.export.fmu import MAX_STEP, c_source, fmu
from scenarios.export.model import ExportedModel, exported
from scenarios.export.targets import python_module
from sim.aerodynamics import parse_term
from sim.declaration.user_model import own_model
from sim.errors import DeclarationError
from sim.vehicles.aircraft import Thrust, aircraft_model
from sim.vehicles.factory import model_from_constants
from tests.airliner import AIRLINER, ELEVATOR
from tests.bases import Flight, base_for, fly
from tests.recorders.quadrotor import TRUTH

BASES = ("ballistic", "rigid", "lateral", "longitudinal", "multirotor", "aircraft")


def case(equations: str) -> tuple[ExportedModel, Any, np.ndarray]:
    model, flight = base_for(equations)
    written = exported(equations, model)
    rows = fly(written.system, flight)
    return written, flight, np.array([np.broadcast_to(row, flight.time.shape) for row in rows])


def module_of(written: ExportedModel) -> ModuleType:
    module = ModuleType("written")
    exec(compile(python_module(written), "written.py", "exec"), module.__dict__)
    return module


@pytest.mark.sampled
@pytest.mark.parametrize("equations", BASES)
def test_the_python_module_flies_the_same(equations: str) -> None:
    written, flight, expected = case(equations)
    module = module_of(written)
    found, states = module.simulate(
        flight.time, flight.u, hold=flight.hold.value == "previous", max_step=flight.max_step
    )
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1e-12
    assert np.abs((found - expected) / scale).max() < 1e-9
    assert states.shape == (len(module.STATES), len(flight.time))
    assert tuple(module.OUTPUTS) == written.system.output_names


def test_a_quaternion_is_written_as_well() -> None:
    flight = base_for("aircraft")[1]
    start = {**AIRLINER.start, "phi": 0.4, "psi": 2.8}
    turned = replace(AIRLINER, attitude="quaternion", further=("psi",), start=start)
    written = exported("turned", aircraft_model(turned))
    expected = np.array(fly(written.system, flight))
    module = module_of(written)
    assert {"e0", "e1", "e2", "e3", "psi_start"} <= set(module.STATES)
    found, _ = module.simulate(flight.time, flight.u, max_step=flight.max_step)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def loop() -> tuple[ExportedModel, Flight, np.ndarray]:
    """Over the vertical, with roll; by a quaternion."""
    start = {"airspeed": 260.0, "alpha": 0.02, "theta": 0.1, "phi": 0.2, "psi": 2.8}
    turned = replace(AIRLINER, attitude="quaternion", further=("psi",), start=start)
    written = exported("loop", aircraft_model(turned))
    time = np.arange(0.0, 14.0 + 1e-9, 0.1)
    elevator = np.where(time < 1.0, ELEVATOR, ELEVATOR - 0.13)
    aileron = 0.01 * np.sign(np.sin(1.3 * time))
    u = np.array([elevator, aileron, 0.0 * time, np.full(len(time), 80e3)])
    flight = Flight(time, u, max_step=MAX_STEP)
    rows = np.array(fly(written.system, flight))
    angles = dict(zip(written.system.output_names, rows, strict=True))
    assert np.max(np.abs(angles["phi"])) > 3.0 and np.max(angles["theta"]) > 1.2
    return written, flight, rows


def test_a_loop_flown_by_the_module_is_ours() -> None:
    written, flight, expected = loop()
    found, _ = module_of(written).simulate(
        flight.time, flight.u, hold=flight.hold.value == "previous", max_step=flight.max_step
    )
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_loop_flown_by_the_unit_is_ours(tmp_path: Path) -> None:
    written, flight, expected = loop()
    content, _ = fmu(written)
    tree, library = unpacked(content, tmp_path)
    found = flown(library, tree, flight)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_parameter_of_the_module_may_be_changed() -> None:
    written, flight, expected = case("rigid")
    module = module_of(written)
    name = "Cm_alpha"
    value = 0.5 * module.PARAMETERS[name]
    found, _ = module.simulate(
        flight.time, flight.u, parameters={name: value}, max_step=flight.max_step
    )
    p = [value if item.name == name else item.value for item in written.system.parameters]
    other = np.array(fly(written.system, flight, p))
    assert np.allclose(found, other, rtol=1e-9, atol=1e-12)
    assert not np.allclose(found, expected, rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("equations", BASES)
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_unit_flies_the_same(equations: str, tmp_path: Path) -> None:
    written, flight, _ = case(equations)
    flight = replace(flight, hold=type(flight.hold)("previous"), max_step=MAX_STEP)
    expected = np.array(
        [np.broadcast_to(row, flight.time.shape) for row in fly(written.system, flight)]
    )
    content, told = fmu(written)
    assert "library" in told
    tree, library = unpacked(content, tmp_path)
    found = flown(library, tree, flight)
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1e-12
    assert np.abs((found - expected) / scale).max() < 1e-9


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_another_program_takes_and_flies_the_unit(tmp_path: Path) -> None:
    """FMPy, where it is installed, finds no fault in the unit, and flies it as it flies here."""
    master = pytest.importorskip("fmpy")
    written, flight, _ = case("aircraft")
    steady = replace(flight, u=np.tile(flight.u[:, 60:61], len(flight.time)), max_step=MAX_STEP)
    expected = np.array(
        [np.broadcast_to(row, flight.time.shape) for row in fly(written.system, steady)]
    )
    path = tmp_path / "unit.fmu"
    path.write_bytes(fmu(written)[0])
    assert pytest.importorskip("fmpy.validation").validate_fmu(str(path)) == []
    names = [signal.name for signal in written.system.inputs]
    found = master.simulate_fmu(
        str(path),
        stop_time=float(flight.time[-1]),
        step_size=float(flight.time[1]),
        output_interval=float(flight.time[1]),
        start_values=dict(zip(names, steady.u[:, 0].tolist(), strict=True)),
        output=list(written.system.output_names),
    )
    for name, row in zip(written.system.output_names, expected, strict=True):
        seen = np.interp(flight.time, found["time"], found[name])
        assert np.abs(seen - row).max() < 1e-9 * max(np.abs(row).max(), 1.0), name


def unpacked(content: bytes, folder: Path) -> tuple[ET.Element, ctypes.CDLL]:
    """Description and library of a unit."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        tree = ET.fromstring(archive.read("modelDescription.xml"))
        (name,) = [each for each in archive.namelist() if each.startswith("binaries/")]
        path = folder / "unit.so"
        path.write_bytes(archive.read(name))
    return tree, ctypes.CDLL(str(path))


def flown(unit: ctypes.CDLL, tree: ET.Element, flight: Any) -> np.ndarray:
    """Outputs at the samples, as a master program steps through the unit."""
    variables = tree.findall("ModelVariables/ScalarVariable")
    outputs, inputs = (
        [int(v.get("valueReference", "")) for v in variables if v.get("causality") == cause]
        for cause in ("output", "input")
    )
    unit.fmi2Instantiate.restype = ctypes.c_void_p
    guid = tree.get("guid", "").encode()
    assert not unit.fmi2Instantiate(b"", 1, b"another", None, None, 0, 0)
    c = ctypes.c_void_p(unit.fmi2Instantiate(b"", 1, guid, None, None, 0, 0))
    zero = ctypes.c_double(float(flight.time[0]))
    assert unit.fmi2SetupExperiment(c, 0, ctypes.c_double(0), zero, 0, ctypes.c_double(0)) == 0
    assert unit.fmi2EnterInitializationMode(c) == unit.fmi2ExitInitializationMode(c) == 0
    refs_in = (ctypes.c_uint * len(inputs))(*inputs)
    refs_out = (ctypes.c_uint * len(outputs))(*outputs)
    values = (ctypes.c_double * len(outputs))()
    rows = []
    for k, t in enumerate(flight.time):
        u = (ctypes.c_double * len(inputs))(*flight.u[:, k])
        assert unit.fmi2SetReal(c, refs_in, ctypes.c_size_t(len(inputs)), u) == 0
        assert unit.fmi2GetReal(c, refs_out, ctypes.c_size_t(len(outputs)), values) == 0
        rows.append(list(values))
        if k + 1 < len(flight.time):
            dt = ctypes.c_double(flight.time[k + 1] - t)
            assert unit.fmi2DoStep(c, ctypes.c_double(t), dt, 1) == 0
    unit.fmi2FreeInstance(c)
    return np.array(rows).T


def test_choices_and_tables_are_written() -> None:
    table = Thrust("throttle", ((0.0, 0.5, 1.0), (0.0, 20e3, 30e3)))
    side = parse_term("abs(beta)", AIRLINER.signals)
    coefficients = {**AIRLINER.coefficients, "Cn": {**AIRLINER.coefficients["Cn"], side: 0.02}}
    aircraft = replace(AIRLINER, thrust=table, coefficients=coefficients)
    written = exported("airliner", aircraft_model(aircraft), aircraft=aircraft)
    module, system = module_of(written), written.system
    x = np.array([125.0, 0.08, -0.06, 0.3, -0.12, 0.2, 0.4, 0.1])
    p = system.parameters.values().tolist()
    for throttle in (-0.1, 0.2, 0.7, 1.2):
        u = np.array([0.05, -0.04, 0.03, throttle])
        expected = [float(each) for each in system.f(0.0, x.tolist(), u.tolist(), p)]
        assert module.derivatives(0.0, x, u) == pytest.approx(expected, rel=1e-12)
    assert "interpolate(" in c_source(written, "x")


def test_a_delay_that_acts_on_whole_records_is_told() -> None:
    written = exported("loes", base_for("loes")[0])
    assert any("Left out" in remark for remark in written.remarks)
    assert "Left out" in python_module(written)


def test_the_fitted_delay_of_a_multirotor_is_left_out_with_its_value() -> None:
    """The delay is a free parameter of the study, which no filter could run."""
    model = model_from_constants("multirotor", {}, TRUTH)
    assert "delay" in model.parameters.free_names
    written = exported("quad", model, {"delay": 0.0123})
    (left,) = (remark for remark in written.remarks if "Left out" in remark)
    assert "input-delay:roll_command (delay 0.0123 s)" in left
    assert left in python_module(written)
    assert not written.system.input_stages


def test_equations_that_decide_are_refused() -> None:
    def rates(s: Any, p: Any) -> dict[str, Any]:
        return {"a": -p.k * s.a if np.all(np.real(s.a) > 0.0) else 0.0 * s.a}

    model = own_model(
        "deciding", {"a": "1"}, {}, {"a": "1"}, {"k": (0.7, "1/s")}, rates, lambda s, p: {"a": s.a}
    )
    with pytest.raises(DeclarationError, match="cannot be written as formulas"):
        python_module(exported("deciding", model))
