"""Uncertain constants in the sigmas of estimates: laws of scale, a random draw of constants, and
tables that cannot be used.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.regression.equation_error import run_equation_error
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.identification.identify import identify
from scenarios.identification.model_checks import (
    consider,
    considered_content,
    considered_sentences,
    considered_table,
)
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import DeclarationError
from tests.every_model import case_of


def uncertain(vehicle: VehicleFile, **shares: float) -> VehicleFile:
    sigmas = {name: share * abs(vehicle.constants[name]) for name, share in shares.items()}
    return replace(vehicle, uncertainty=sigmas)


@pytest.mark.parametrize("method", ["output-error"])
def test_moments_scale_with_inertia_and_forces_with_mass(method: str) -> None:
    """qS c Cm / Iy and qS CL / m are all that the motion knows: 2 % of Iy are 2 % of each Cm."""
    case = case_of("rigid", 1)
    plain = identify(case.record, case.vehicle, method)
    found = identify(case.record, uncertain(case.vehicle, mass=0.01, pitch_inertia=0.02), method)
    considered = found.considered
    assert considered is not None and considered.constants == ("mass", "pitch_inertia")
    assert np.array_equal(found.estimate.values, plain.estimate.values)
    for k, name in enumerate(considered.names):
        of_mass, of_inertia = considered.moved[:, k]
        value, sigma = plain.estimate.value(name), plain.estimate.sigma(name)
        if name.startswith("Cm_"):
            assert of_inertia == pytest.approx(0.02 * value, rel=1e-2)
            assert abs(of_mass) < 0.02 * max(abs(value) * 0.01, sigma)
        if name.startswith("CL_"):
            assert of_mass == pytest.approx(0.01 * value, rel=1e-2, abs=0.02 * sigma)
        total = np.sqrt(sigma**2 + of_mass**2 + of_inertia**2)
        assert found.estimate.sigma(name) == pytest.approx(total, rel=1e-9)
        assert np.sum(considered.shares[:, k]) == pytest.approx(1.0)
    rows = {row.name: row.std for row in found.rows}
    assert rows["Cm_alpha"] == found.estimate.sigma("Cm_alpha")
    names = tuple(row.name for row in found.rows)
    shown = considered_table(considered, names)
    assert [row[0] for row in shown.rows] == list(names)
    content = considered_content(considered)["uncertain_constants"]
    assert content["parameters"]["Cm_alpha"]["dominant"] == considered.dominant("Cm_alpha")
    assert plain.considered is None and considered_content(plain.considered) == {}


@pytest.mark.long
def test_the_covariance_is_that_of_drawn_constants() -> None:
    """Estimates with constants drawn from their distribution scatter as the added covariance."""
    case = case_of("lateral", 1)
    shares = {"mass": 0.01, "roll_inertia": 0.03, "yaw_inertia": 0.02, "airspeed": 0.01}
    vehicle = uncertain(case.vehicle, **shares)

    def estimated(model: Model) -> Estimate:
        outputs = [name for name in ("beta", "p", "r", "phi") if name in case.record.output_names]
        return run_equation_error([case.record], compile_model(model, outputs))

    model = model_of_file(vehicle)
    _, considered = consider(model, vehicle.uncertainty, estimated(model), estimated)
    assert considered is not None and considered.constants == tuple(shares)
    rng = np.random.default_rng(3)
    drawn = [
        estimated(
            model.with_values(
                {
                    name: vehicle.constants[name] + sigma * rng.standard_normal()
                    for name, sigma in vehicle.uncertainty.items()
                }
            )
        ).values
        for _ in range(40)
    ]
    added = np.sqrt(np.sum(considered.moved**2, axis=0))
    strong = added > 0.2 * considered.data
    assert np.sum(strong) >= 3
    # 40 draws tell a standard deviation to 11 %.
    assert np.all(np.abs(np.std(drawn, axis=0) / added - 1.0)[strong] < 0.4)


def test_a_constant_with_which_the_fit_fails_is_named() -> None:
    """Its share is left out, and a caution says so."""
    case = case_of("rigid", 1)
    estimate = identify(case.record, case.vehicle, "equation-error").estimate
    broken = replace(estimate, outcome=Outcome.DIVERGED)
    model = model_of_file(case.vehicle)
    same, considered = consider(model, {"mass": 1.0}, estimate, lambda _: broken)
    assert np.array_equal(same.covariance, estimate.covariance)
    assert considered is not None and considered.failed == ("mass",)
    assert "mass is not in the sigmas" in considered_sentences(considered)[0]
    assert consider(model, {"mass": 1.0}, broken, lambda _: broken) == (broken, None)


RIGID = """\
mass = 2300.0
wing_area = 17.0
chord = 1.6
pitch_inertia = 4000.0
airspeed = 60.0
air_density = 1.1
[derivatives]
CL_alpha = 5.0
CL_q = 4.0
CL_de = 0.4
Cm_alpha = -0.9
Cm_q = -12.0
Cm_de = -1.5
"""


def test_a_file_states_shares_and_units(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(RIGID + '[uncertainty]\nmass = "1.5 %"\nairspeed = "2 kt"\n')
    vehicle = read_vehicle(path, "rigid")
    assert vehicle.uncertainty == pytest.approx({"mass": 34.5, "airspeed": 2 * 1852 / 3600})
    path.write_text(RIGID)
    assert read_vehicle(path, "rigid").uncertainty == {}


def test_a_file_of_an_aircraft_states_them_too(tmp_path: Path) -> None:
    text = Path("scenarios/catalog/aircraft/airliner.toml").read_text()
    path = tmp_path / "airliner.toml"
    path.write_text(text + '\n[uncertainty]\npitch_inertia = "3 %"\ncg_x = 0.05\n')
    assert read_vehicle(path, "aircraft").uncertainty == pytest.approx(
        {"pitch_inertia": 9900.0, "cg_x": 0.05}
    )


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("masss = 10.0", "there is no constant masss; did you mean 'mass'"),
        ("Cm_q = 1.0", "there is no constant Cm_q"),
        ('mass = "3 m"', "uncertainty.mass"),
        ("mass = 0.0", "0.0 is no standard deviation"),
        ('mass = "80 %"', "1840 kg is more than half of mass, 2300"),
        ("mass = -1.0", "-1.0 is no standard deviation"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path: Path, lines: str, message: str) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(f"{RIGID}[uncertainty]\n{lines}\n")
    with pytest.raises(DeclarationError) as caught:
        read_vehicle(path, "rigid")
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_the_low_order_filter_refuses_them() -> None:
    case = case_of("loes", 1)
    with pytest.raises(DeclarationError, match="takes constants as exact"):
        identify(case.record, uncertain(case.vehicle, airspeed=0.01), "ekf")
