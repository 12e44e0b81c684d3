"""What a vehicle file lays down: grammar, what becomes of it, and one line for each way to get it
wrong.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from scenarios.files.user_models import side_at
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.model import Tie
from sim.errors import DeclarationError
from tests.own_models import ROLL, model_file

HEAD = (
    "mass = 7500.0\nwing_area = 30.1\nchord = 2.43\npitch_inertia = 32000.0\nairspeed = "
    "130.0\nair_density = 0.96\n"
)
STARTS = {
    "CL_alpha": 5.1,
    "CL_q": 6.0,
    "CL_de": 0.42,
    "Cm_alpha": -0.92,
    "Cm_q": -17.0,
    "Cm_de": -1.35,
}


def read(
    folder: Path, tail: str = "", top: str = "", without: tuple[str, ...] = (), model: str = "rigid"
) -> VehicleFile:
    starts = "".join(f"{name} = {value}\n" for name, value in STARTS.items() if name not in without)
    path = folder / "v.toml"
    path.write_text(f"{HEAD}{top}\n[derivatives]\n{starts}{tail}\n")
    return read_vehicle(path, model)


@pytest.mark.parametrize(
    ("value", "bounds", "side"),
    [
        (-33.0, (-33.0, 0.0), "lower"),
        (-33.0 + 1e-8, (-33.0, 0.0), "lower"),
        (-32.9, (-33.0, 0.0), ""),
        (-1e-12, (-33.0, 0.0), "upper"),
        (0.0, (0.0, math.inf), "lower"),
        (1e-12, (0.0, math.inf), ""),
        (1e9, (-math.inf, math.inf), ""),
    ],
)
def test_at_a_bound_is_within_rounding_of_the_larger_one(
    value: float, bounds: tuple[float, float], side: str
) -> None:
    assert side_at(value, bounds) == side


def test_a_file_without_any_is_as_it_was(tmp_path: Path) -> None:
    vehicle = read(tmp_path)
    assert not vehicle.constraints and all(
        model_of_file(vehicle).parameters[name].free for name in STARTS
    )


def test_parameters_are_fixed_by_value_or_by_name(tmp_path: Path) -> None:
    by_value = model_of_file(
        read(tmp_path, '[fixed]\nCm_q = "-12.5 1/rad"', without=("Cm_q",))
    ).parameters
    assert by_value["Cm_q"].value == -12.5 and not by_value["Cm_q"].free and by_value["Cm_de"].free
    by_name = model_of_file(read(tmp_path, top='fixed = ["Cm_q", "CL_q"]')).parameters
    assert [name for name in STARTS if not by_name[name].free] == ["CL_q", "Cm_q"] and by_name[
        "Cm_q"
    ].value == -17.0


def test_bounds_and_ties_reach_the_model(tmp_path: Path) -> None:
    tail = (
        "[bounds]\nCm_q = [-30, 0]\nCL_alpha = [3.0, inf]\n[tied]\nCL_q = [{parameter = "
        '"CL_alpha", factor = 1.2}, {constant = 0.1}]'
    )
    vehicle = read(tmp_path, tail, without=("CL_q",))
    model = model_of_file(vehicle)
    assert model.parameters["Cm_q"].bounds == (-30.0, 0.0) and model.parameters[
        "CL_alpha"
    ].bounds == (3.0, math.inf)
    assert model.ties == (Tie("CL_q", (("CL_alpha", 1.2),), 0.1),)
    assert (
        model.parameters["CL_q"].value == pytest.approx(1.2 * 5.1 + 0.1)
        and not model.parameters["CL_q"].free
    )


def test_bounds_of_the_equations_stay(tmp_path: Path) -> None:
    text = (
        "airspeed = 208.0\ngravity = 9.8\n[derivatives]\nL_alpha = -1.5\nM_alpha = -6.5\nL_delta = "
        "-0.003\nM_delta = 0.3\nL_q = 0.97\n"
    )
    path = tmp_path / "v.toml"
    path.write_text(
        f"{text}M_q = -2.3\ninv_tau = 10.4\ndelay = 0.07\n[bounds]\ndelay = [-1.0, 0.2]\n"
    )
    assert model_of_file(read_vehicle(path, "loes")).parameters["delay"].bounds == (0.0, 0.2)


def test_an_own_model_has_them_too(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text('fixed = ["L_da"]\n[bounds]\nL_p = [-4.0, 0.0]\n')
    vehicle = read_vehicle(path, str(model_file(tmp_path, ROLL)))
    parameters = model_of_file(vehicle).parameters
    assert (
        not parameters["L_da"].free
        and parameters["L_da"].value == 8.0
        and parameters["L_p"].bounds == (-4.0, 0.0)
    )


@pytest.mark.parametrize(
    ("tail", "top", "without", "said"),
    [
        (
            "[fixed]\nCm_x = 1.0",
            "",
            (),
            r"key fixed\.Cm_x: there is no parameter 'Cm_x' to be estimated; did you mean 'Cm_",
        ),
        (
            "[fixed]\nmass = 1.0",
            "",
            (),
            r"key fixed\.mass: there is no parameter 'mass' to be estimated",
        ),
        (
            "[fixed]\nCm_q = 1.0",
            "",
            (),
            r"key fixed\.Cm_q: given twice, also under derivatives; keep one of the two",
        ),
        ('[fixed]\nCm_q = "1 kg"', "", ("Cm_q",), r"key fixed\.Cm_q: .*1/rad"),
        ("[fixed]\nCm_q = true", "", ("Cm_q",), r"key fixed\.Cm_q: True is not a number"),
        (
            "",
            'fixed = ["Cm_q"]',
            ("Cm_q",),
            r"key fixed: Cm_q has no value to be fixed at; give it under \[derivatives\]",
        ),
        ("", "fixed = 3", (), "key fixed: this is no table; write"),
        (
            "[bounds]\nCm_q = [0, -30]",
            "",
            (),
            r"key bounds\.Cm_q: 0 is not below -30; give the lower bound first",
        ),
        (
            "[bounds]\nCm_q = [-10, 0]",
            "",
            (),
            r"key bounds\.Cm_q: the start -17 lies outside \[-10, 0\]; widen the bounds or move "
            r"the start",
        ),
        ("[bounds]\nCm_q = -10", "", (), r"key bounds\.Cm_q: this is no pair; write \[low, high\]"),
        (
            "[bounds]\nCm_q = [-10, nan]",
            "",
            (),
            r"key bounds\.Cm_q: value nan is not a finite number",
        ),
        (
            "[bounds]\nCm_q = [-30, 0]",
            'fixed = ["Cm_q"]',
            (),
            r"key bounds\.Cm_q: it is fixed or tied; leave its bounds out",
        ),
        (
            '[tied]\nCm_q = {parameter = "Cm_de", factor = 9.0}',
            "",
            (),
            r"key tied\.Cm_q: given twice, also under derivatives",
        ),
        (
            '[tied]\nCm_q = "9 * Cm_de"',
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: this is no tie; write NAME = \{parameter",
        ),
        (
            '[tied]\nCm_q = {parameter = "Cm_de"}',
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: a term has no factor",
        ),
        (
            "[tied]\nCm_q = {factor = 2.0}",
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: a term has no parameter",
        ),
        (
            "[tied]\nCm_q = {constant = 2.0}",
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: it follows no parameter; a constant alone belongs under \[fixed\]",
        ),
        (
            '[tied]\nCm_q = {parameter = "Cm_d", factor = 1}',
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: there is no parameter 'Cm_d' to be estimated",
        ),
        (
            '[tied]\nCm_q = {parameter = "Cm_q", factor = 1}',
            "",
            ("Cm_q",),
            r"key tied\.Cm_q: it follows itself",
        ),
        ("[derivatives2]\nx = 1", "", (), "key derivatives2: there is no such key"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, tail: str, top: str, without: tuple[str, ...], said: str
) -> None:
    with pytest.raises(DeclarationError, match=rf"v\.toml, {said}"):
        read(tmp_path, tail, top, without)


def test_something_is_left_to_estimate(tmp_path: Path) -> None:
    with pytest.raises(
        DeclarationError, match="every parameter is fixed or tied: nothing is left to estimate"
    ):
        read(tmp_path, top=f"fixed = {list(STARTS)}")


def test_a_fault_of_a_value_names_the_table_it_stands_in(tmp_path: Path) -> None:
    text = (
        "airspeed = 208.0\ngravity = 9.8\n[derivatives]\nL_alpha = -1.5\nM_alpha = -6.5\nL_delta = "
        "-0.003\nM_delta = 0.3\nL_q = 0.97\n"
    )
    path = tmp_path / "v.toml"
    path.write_text(f"{text}M_q = -2.3\ninv_tau = 10.4\n[fixed]\ndelay = -0.07\n")
    with pytest.raises(DeclarationError, match=r"key fixed\.delay: value -0\.07 is below 0"):
        read_vehicle(path, "loes")
