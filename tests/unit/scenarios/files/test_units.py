"""Units at the border: which are read, which are refused, and that our own need no library."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.units import QUANTITIES, to_si
from sim.errors import DeclarationError, RecordError

DEGREE = math.pi / 180.0
POUND, FOOT, POUND_FORCE = 0.45359237, 0.3048, 0.45359237 * 9.80665
SLUG = POUND_FORCE / FOOT

READ = [
    ("deg", "rad", DEGREE),
    ("°", "rad", DEGREE),
    ("DEG", "rad", DEGREE),
    ("mrad", "rad", 1e-3),
    ("1", "rad", 1.0),
    ("deg/s", "rad/s", DEGREE),
    ("deg s^-1", "rad/s", DEGREE),
    ("1/s", "rad/s", 1.0),
    ("Hz", "rad/s", 2.0 * math.pi),
    ("rpm", "rad/s", 2.0 * math.pi / 60.0),
    ("1/deg", "1/rad", 1.0 / DEGREE),
    ("1", "1/rad", 1.0),
    ("rad/s", "1/s", 1.0),
    ("s-2", "1/s2", 1.0),
    ("g", "g", 1.0),
    ("1", "g", 1.0),
    ("m/s^2", "g", 1.0 / 9.80665),
    ("ft/s2", "g", FOOT / 9.80665),
    ("g", "m/s2", 9.80665),
    ("g", "kg", 1e-3),
    ("lb", "kg", POUND),
    ("lbm", "kg", POUND),
    ("slug", "kg", SLUG),
    ("ft", "m", FOOT),
    ("in", "m", 0.0254),
    ("ft²", "m2", FOOT**2),
    ("kt", "m/s", 1852.0 / 3600.0),
    ("knots", "m/s", 1852.0 / 3600.0),
    ("ms", "s", 1e-3),
    ("kPa", "Pa", 1e3),
    ("kg/m/s2", "Pa", 1.0),
    ("lbf/ft^2", "Pa", POUND_FORCE / FOOT**2),
    ("lb/ft2", "Pa", POUND_FORCE / FOOT**2),
    ("psf", "Pa", POUND_FORCE / FOOT**2),
    ("lb/ft2", "kg/m2", POUND / FOOT**2),
    ("lbf/ft2", "kg/m2", POUND / FOOT**2),
    ("slug/ft^3", "kg/m3", SLUG / FOOT**3),
    ("slug ft2", "kg m2", SLUG * FOOT**2),
    ("slug-ft^2", "kg m2", SLUG * FOOT**2),
    ("kg-m2", "kg m2", 1.0),
]

WRONG = [
    ("kg", "rad"),
    ("%", "rad"),
    ("m", "rad/s"),
    ("rad", "rad/s"),
    ("rad", "1/rad"),
    ("Hz", "1/s"),
    ("deg", "1"),
    ("rad", "g"),
    ("m", "g"),
    ("1", "m"),
    ("lbf", "kg"),
    ("N/m2", "kg/m2"),
    ("degF", "m"),
    ("ft", "s"),
]


@pytest.mark.parametrize(("unit", "target", "factor"), READ)
def test_a_unit_of_the_right_dimension_is_converted(unit: str, target: str, factor: float) -> None:
    assert to_si(2.0, unit, target, "here") == pytest.approx(2.0 * factor, rel=1e-12)


@pytest.mark.parametrize("target", QUANTITIES)
def test_our_own_unit_changes_no_bit(target: str) -> None:
    values = np.array([0.1, -0.0, 1e-310, np.nan])
    assert to_si(values, target, target, "here").tobytes() == values.tobytes()
    assert to_si(values, "", target, "here").tobytes() == values.tobytes()


def test_an_array_keeps_its_missing_samples() -> None:
    np.testing.assert_allclose(
        to_si(np.array([180.0, np.nan]), "deg", "rad", "here"), [math.pi, np.nan], rtol=1e-15
    )


@pytest.mark.parametrize(("unit", "target"), WRONG)
def test_a_unit_of_the_wrong_dimension_is_refused(unit: str, target: str) -> None:
    with pytest.raises(RecordError) as caught:
        to_si(1.0, unit, target, "run.csv, column 'x'")
    message = str(caught.value)
    assert "\n" not in message
    assert (
        message.startswith("run.csv, column 'x': ")
        and repr(unit) in message
        and QUANTITIES[target][0] in message
    )
    assert caught.value.remedy == f"write {QUANTITIES[target][1]}"


@pytest.mark.parametrize("unit", ["foo", "(", "2*m", "__import__('os')", "m; m", "x" * 100])
def test_an_unknown_unit_is_refused(unit: str) -> None:
    with pytest.raises(DeclarationError, match="unknown unit") as caught:
        to_si(1.0, unit, "m", "plane.toml, key chord", DeclarationError)
    assert (
        "\n" not in str(caught.value)
        and "plane.toml, key chord" in str(caught.value)
        and caught.value.remedy
    )


@pytest.mark.long
def test_si_units_and_degrees_need_no_unit_library(tmp_path: Path) -> None:
    script = """
import sys
from scenarios.files.records import read_record
from scenarios.files.vehicles import read_vehicle
open("r.csv", "w").write("time [s],elevator_rad,alpha_deg,q [deg/s],nz_g,ax [m/s2]\\n0,0,0,0,1,0\\n1,0,0,0,1,0\\n")
open("v.toml", "w").write('airspeed = "100 m/s"\\ngravity = "1 g"\\n[derivatives]\\nL_alpha = -1\\nM_alpha = "-2 1/s2"\\nL_delta = 0\\n'
                          'M_delta = 1\\nL_q = 1\\nM_q = -1\\ninv_tau = 10\\ndelay = "0.1 s"\\n')
read_record("r.csv", ["elevator"], ["alpha", "q", "nz"], optional=["ax"])
read_vehicle("v.toml", "loes")
print([name for name in ("pint", "pandas", "scipy") if name in sys.modules])
open("r.csv", "w").write("time,alpha_mrad\\n0,0\\n1,0\\n")
read_record("r.csv", [], ["alpha"])
print("pint" in sys.modules)
"""  # noqa: E501
    root = str(Path(__file__).parents[4])
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {root!r})\n{script}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split("\n")[:2] == ["[]", "True"]
