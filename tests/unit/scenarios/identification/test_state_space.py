"""Matrices of an identified model: the point, the modes that are printed, and files that read
back.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import expm

from ident.flying_qualities.modes import StateSpace
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.identification.files import refuse_place, state_space_of, write_state_space
from scenarios.identification.identify import identify
from sim.errors import DeclarationError
from sim.record import Channel, Hold, Record
from tests.own_models import SPRING
from tests.rigid_problem import ballistic_record
from tests.whole_axes import flown, vehicle_file


@pytest.fixture(scope="module")
def longitudinal() -> StateSpace:
    found = identify(flown("longitudinal", 3), vehicle_file("longitudinal", 0.8), "equation-error")
    space = state_space_of(found)
    slow, quick = (pair[1] for pair in np.split(space.eigenvalues, 2))
    for root, mode in ((slow, "phugoid"), (quick, "short_period")):
        assert abs(root) == pytest.approx(found.derived[f"{mode}_frequency"][0], rel=1e-9)
        assert -root.real / abs(root) == pytest.approx(
            found.derived[f"{mode}_damping"][0], rel=1e-9
        )
    return space


@pytest.mark.long
def test_totals_are_linearised_about_level_flight(longitudinal: StateSpace) -> None:
    """Whose roots are the modes that are printed."""
    assert np.max(np.abs(longitudinal.rates)) < 1e-8 and longitudinal.x0[0] == 62.0
    outputs = dict(zip([s.name for s in longitudinal.outputs], longitudinal.y0, strict=True))
    assert outputs["nz"] ** 2 + outputs["nx"] ** 2 == pytest.approx(1.0, abs=1e-6), (
        "the specific force of level flight is one g"
    )


@pytest.mark.long
def test_files_read_back(longitudinal: StateSpace, tmp_path: Path) -> None:
    for ending in ("json", "mat", "npz"):
        write_state_space(longitudinal, tmp_path / "new" / f"plant.{ending}")
    content = json.loads((tmp_path / "new" / "plant.json").read_text(), parse_constant=pytest.fail)
    arrays, cells = np.load(tmp_path / "new" / "plant.npz"), loadmat(tmp_path / "new" / "plant.mat")
    for name in "ABCD":
        for read in (np.array(content[name]), arrays[name], cells[name]):
            np.testing.assert_array_equal(read, getattr(longitudinal, name))
    names, units = ["airspeed", "alpha", "theta", "q"], ["m/s", "rad", "rad", "rad/s"]
    assert [(s["name"], s["unit"]) for s in content["states"]] == list(
        zip(names, units, strict=True)
    )
    assert (
        arrays["states_names"].tolist() == names
        and [cell[0].item() for cell in cells["states_names"]] == names
    )
    assert (
        arrays["inputs_units"].tolist() == ["rad", "N"]
        and content["delays"] == {}
        and content["left_out"] == []
    )
    assert [complex(*pair) for pair in content["eigenvalues"]] == longitudinal.eigenvalues.tolist()


def test_a_falling_body_is_linearised_where_it_is_in_the_middle(tmp_path: Path) -> None:
    body = {"air_density_reference": 1.225, "density_scale_height": 7160.0, "gravity": 9.79}
    found = identify(
        ballistic_record(np.random.default_rng(2)),
        VehicleFile("body", "ballistic", body, {"beta": 2200.0}),
        "output-error",
    )
    space = state_space_of(found)
    h, v = space.x0
    middle = found.record["altitude"].values[len(found.record) // 2]
    assert abs(h - middle) < 0.1 * abs(middle) and v < 0.0
    density, beta = 1.225 * np.exp(-h / 7160.0), found.estimate.value("beta")
    expected = [[0.0, 1.0], [-0.5 * density * v**2 / beta / 7160.0, density * v / beta]]
    np.testing.assert_allclose(space.A, expected, rtol=1e-9)
    assert space.B.shape == (2, 0) and space.rates[0] == v


def test_an_own_model_is_linearised_about_its_rest(tmp_path: Path) -> None:
    path = tmp_path / "spring.py"
    path.write_text(SPRING)
    vehicle = read_vehicle(None, str(path))
    time = np.arange(0.0, 6.0, 0.05)
    force = np.where((time > 0.5) & (time < 1.5), 2.0, 0.0)
    held = expm(0.05 * np.array([[0.0, 1.0, 0.0], [-25.0, -0.5, 0.5], [0.0, 0.0, 0.0]]))
    motion = [np.zeros(2)]
    for push in force[:-1]:
        motion.append((held @ [*motion[-1], push])[:2])
    x = np.array(motion)[:, 0] + 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    record = Record(
        time,
        (Channel.of("force", "N", force),),
        (Channel.of("x", "m", x),),
        Hold.PREVIOUS,
        "spring.csv",
    )
    space = state_space_of(identify(record, vehicle, "output-error"))
    assert space.A[1] == pytest.approx([-25.0, -0.5], rel=0.02) and space.B[:, 0] == pytest.approx(
        [0.0, 0.5]
    )


def test_an_ending_that_no_format_has_is_refused() -> None:
    with pytest.raises(
        DeclarationError,
        match=r"plant.txt: .txt ending; name a file that ends in .json, .mat, .npz",
    ):
        refuse_place(Path("plant.txt"))


@pytest.mark.parametrize("name", ["flight.json", "flight.mat", "sub/../flight.mat"])
def test_what_is_read_is_not_written_over(tmp_path: Path, name: str) -> None:
    """Neither the record nor what stands beside it, whatever way there is named."""
    (tmp_path / "sub").mkdir()
    with pytest.raises(DeclarationError, match="would take the place of a record or of the study"):
        refuse_place(tmp_path / name, [tmp_path / "flight.mat"])
    refuse_place(tmp_path / "plant.json", [tmp_path / "flight.mat"])
    (tmp_path / "plant.mat").mkdir()
    with pytest.raises(DeclarationError, match="this is a folder"):
        refuse_place(tmp_path / "plant.mat")
