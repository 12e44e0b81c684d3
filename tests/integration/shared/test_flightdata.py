"""Every measured file that is here, from the file to numbers with at most three commands and no
script, as its owner would do it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.integration.command_line import CommandLine

FLIGHTDATA = Path(__file__).parents[4] / "shared" / "flightdata"
pytestmark = pytest.mark.skipif(
    not FLIGHTDATA.is_dir(), reason="the folder of measured flights is not here"
)
NO_RECORDS = ("README.md", "LICENSE.RocketPy", "LICENCE.alpha_beta_modules")


@dataclass(frozen=True)
class Use:
    """What the owner of a file does after ``flightid map FILE``.

    Attributes
    ----------
    command : with its options; the file, ``--channels`` and ``--vehicle`` or ``--model`` are added
        where there are any.
    channels, vehicle, model : contents of a channel map, a vehicle file and a model of one's own.
    holds : parameter -> least and most of its estimate. prints : words of the output. refused :
        words of the refusal.
    """

    command: str
    channels: str = ""
    vehicle: str = ""
    model: str = ""
    holds: tuple[tuple[str, float, float], ...] = ()
    prints: tuple[str, ...] = ()
    refused: str = ""


def falling(density: float, beta: float, scale_height: float = 8500.0) -> str:
    """A vehicle file of a falling body."""
    head = (
        f'name = "body"\nair_density_reference = {density}\ndensity_scale_height = '
        f"{scale_height}\ngravity = 9.80665\n"
    )
    return f"{head}[derivatives]\nbeta = {beta}\n"


ATTAS = """
time = 1
beta = {column = 14, unit = "deg"}
p = {column = 7, unit = "deg/s"}
r = {column = 9, unit = "deg/s"}
phi = {column = 10, unit = "deg"}
ay = {column = 3, unit = "m/s2"}
aileron = {column = "0.5*(NAME29 - NAME28)", unit = "deg"}
rudder = {column = 30, unit = "deg"}
"""
ATTAS_VEHICLE = """
name = "twin-jet"
mass = 17600.0
wing_area = 64.0
span = 21.5
roll_inertia = 134000.0
yaw_inertia = 320000.0
cross_inertia = 14000.0
airspeed = 130.0
air_density = 0.8
trim_alpha = 0.05
trim_theta = 0.05
[derivatives]
CY_beta = -1.0
CY_dr = 0.2
Cl_beta = -0.1
Cl_p = -0.7
Cl_r = 0.2
Cl_da = -0.1
Cl_dr = 0.02
Cn_beta = 0.1
Cn_p = -0.05
Cn_r = -0.2
Cn_da = 0.0
Cn_dr = -0.1
"""
HFB = """
time = 1
elevator = 2
thrust = 4
airspeed = 5
alpha = 6
theta = 7
q = 8
"""
HFB_VEHICLE = """
name = "small twin-jet"
mass = 7472.0
wing_area = 30.1
chord = 2.43
pitch_inertia = 91420.0
reference_airspeed = 104.67
air_density = 0.792
thrust_arm = 0.0
[derivatives]
CD_0 = 0.12
CD_V = -0.06
CD_alpha = 0.3
CL_0 = -0.1
CL_V = 0.1
CL_alpha = 4.0
Cm_0 = 0.1
Cm_V = 0.0
Cm_alpha = -1.0
Cm_q = -25.0
Cm_de = -1.5
"""
OTTER_VEHICLE = """
name = "commuter"
mass = 4725.0
wing_area = 39.25
chord = 1.98
pitch_inertia = 32290.0
airspeed = 46.6
air_density = 0.98
[derivatives]
CL_alpha = 5.0
CL_q = 5.0
CL_de = 0.4
Cm_alpha = -1.5
Cm_q = -20.0
Cm_de = -1.5
"""
ROLL = """
from sim.declaration import own_model
MODEL = own_model(
    name="roll",
    states={"p": "rad/s", "angle": "rad"},
    inputs={"command": "1"},
    outputs={"p": "rad/s"},
    parameters={"L_p": (-5.0, "1/s"), "L_c": (20.0, "rad/s2"), "L_phi": (-5.0, "1/s2")},
    rates=lambda s, p: {"p": p.L_p * s.p + p.L_c * s.command + p.L_phi * s.angle, "angle": s.p},
    readings=lambda s, p: {"p": s.p},
)
"""
NOMOTO = """
from sim.declaration import own_model
MODEL = own_model(
    name="nomoto",
    states={"psi": "rad", "r": "rad/s"},
    inputs={"rudder": "rad"},
    outputs={"psi": "rad", "r": "rad/s"},
    parameters={"K": (-0.05, "1/s"), "T": (40.0, "s")},
    rates=lambda s, p: {"psi": s.r, "r": (p.K * s.rudder - s.r) / p.T},
    readings=lambda s, p: {"psi": s.psi, "r": s.r},
)
"""
UNSTABLE = """
from sim.declaration import own_model
MODEL = own_model(
    name="short period in w",
    states={"w": "m/s", "q": "rad/s"},
    inputs={"elevator": "rad"},
    outputs={"w": "m/s", "q": "rad/s"},
    constants={"u0": (44.57, "m/s")},
    parameters={"Z_w": (-1.0, "1/s"), "Z_q": (0.0, "m/s"), "Z_de": (-5.0, "m/s2"),
                "M_w": (0.1, "rad/(m s)"), "M_q": (-3.0, "1/s"), "M_de": (-10.0, "1/s2")},
    rates=lambda s, p: {"w": p.Z_w * s.w + (p.u0 + p.Z_q) * s.q + p.Z_de * s.elevator,
                        "q": p.M_w * s.w + p.M_q * s.q + p.M_de * s.elevator},
    readings=lambda s, p: {"w": s.w, "q": s.q},
    biases=(),
)
"""
LATERAL = """
from sim.declaration import own_model
MODEL = own_model(
    name="roll and yaw",
    states={"p": "rad/s", "r": "rad/s"},
    inputs={"aileron": "rad", "rudder": "rad", "v": "m/s"},
    outputs={"p": "rad/s", "r": "rad/s"},
    parameters={"L_p": (-5.0, "1/s"), "L_r": (1.0, "1/s"), "L_da": (-15.0, "1/s2"), "L_dr": (0.5, "1/s2"), "L_v": (-0.1, "rad/(m s)"),
                "N_p": (-0.5, "1/s"), "N_r": (-0.5, "1/s"), "N_da": (-0.5, "1/s2"), "N_dr": (-2.0, "1/s2"), "N_v": (0.01, "rad/(m s)")},
    rates=lambda s, p: {"p": p.L_p * s.p + p.L_r * s.r + p.L_da * s.aileron + p.L_dr * s.rudder + p.L_v * s.v,
                        "r": p.N_p * s.p + p.N_r * s.r + p.N_da * s.aileron + p.N_dr * s.rudder + p.N_v * s.v},
    readings=lambda s, p: {"p": s.p, "r": s.r},
)
"""  # noqa: E501
SECOND_ORDER = """
from sim.declaration import own_model
MODEL = own_model(
    name="second order",
    states={"x": "1", "v": "1/s"},
    inputs={"u": "1"},
    outputs={"z": "1"},
    parameters={"b1": (0.3, "1/s"), "b0": (0.2, "1/s2"), "a1": (1.2, "1/s"), "a0": (1.5, "1/s2")},
    rates=lambda s, p: {"x": s.v, "v": s.u - p.a1 * s.v - p.a0 * s.x},
    readings=lambda s, p: {"z": p.b1 * s.v + p.b0 * s.x},
)
"""
HARV = """
time = "t"
airspeed = {column = "fdata_250h2", unit = "ft/s"}
beta = {column = "fdata_250h3", unit = "deg"}
alpha = {column = "fdata_250h4", unit = "deg"}
p = {column = "fdata_250h5", unit = "deg/s"}
q = {column = "fdata_250h6", unit = "deg/s"}
r = {column = "fdata_250h7", unit = "deg/s"}
phi = {column = "fdata_250h8", unit = "deg"}
theta = {column = "fdata_250h9", unit = "deg"}
psi = {column = "fdata_250h10", unit = "deg"}
ax = {column = "fdata_250h11", unit = "g"}
ay = {column = "fdata_250h12", unit = "g"}
az = {column = "fdata_250h13", unit = "g"}
"""


HFB_NAMES = "time,elevator,pdyn,thrust,airspeed,alpha,theta,q,qdot,axc,azc,ayc,p,r,pdot,rdot,beta,phi,aileron,rudder"  # noqa: E501
OTTER = """
elevator = {column = "* elevator (deg)", unit = "deg"}
alpha = {column = "* alpha (deg)", unit = "deg"}
q = {column = "* q (deg/sec)", unit = "deg/s"}
nz = {column = "* az (g)", unit = "g", sign = -1}
theta = {column = "* theta (deg)", unit = "deg"}
airspeed = {column = "* airspeed (ft/sec)", unit = "ft/s"}
dynamic_pressure = false
"""
SHIP = """
psi = {column = "psi", unit = "deg"}
r = {column = "r", unit = "deg/s"}
rudder = {column = "rudder", unit = "deg"}
"""
HELICOPTER = """
elevator = "_elev,yoke1"
aileron = "ailrn,yoke1"
rudder = "ruddr,yoke1"
alpha = false
p = "____P,rad/s"
q = "____Q,rad/s"
r = "____R,rad/s"
phi = {column = "_roll,__deg", unit = "deg"}
theta = {column = "pitch,__deg", unit = "deg"}
airspeed = {column = "Vtrue,_ktas", unit = "kt"}
"""
FIXED_WING = """
elevator = "elevator"
q = "ang_vel_y"
theta = "pitch(q0, q1, q2, q3)"
ax = "acc_b_x"
az = "acc_b_z"
airspeed = "sqrt(vx**2 + vy**2 + vz**2)"
"""
PX4_RATES = """
p = "sensor_combined.gyro_rad[0]"
q = "sensor_combined.gyro_rad[1]"
r = "sensor_combined.gyro_rad[2]"
phi = "roll(vehicle_attitude.q[0], vehicle_attitude.q[1], vehicle_attitude.q[2], vehicle_attitude.q[3])"
theta = "pitch(vehicle_attitude.q[0], vehicle_attitude.q[1], vehicle_attitude.q[2], vehicle_attitude.q[3])"
"""  # noqa: E501
PX4_ROLL = """
command = "actuator_controls_0.control[0]"
p = "sensor_combined.gyro_rad[0]"
"""
ARDUPILOT = """
aileron = {column = "ATT.DesRoll", unit = "deg"}
p = "IMU.GyrX"
q = "IMU.GyrY"
r = "IMU.GyrZ"
phi = {column = "ATT.Roll", unit = "deg"}
theta = {column = "ATT.Pitch", unit = "deg"}
psi = {column = "ATT.Yaw", unit = "deg"}
"""


def attas(name: str) -> tuple[Use, ...]:
    """What is done with one of the four records of the twin-jet."""
    mapped = ATTAS.replace("NAME", name)
    return (
        Use("map", prints=("rows of 46 columns", "time = 1")),
        Use("identify FILE --model lateral", mapped, ATTAS_VEHICLE, holds=(("Cl_p", -1.2, -0.3),)),
        Use("maneuvers FILE", mapped),
    )


def fall(start: str, channels: str, body: str, *holds: tuple[str, float, float]) -> tuple[Use, ...]:
    """What is done with the record of a falling body."""
    command = f"identify FILE --model ballistic {start}"
    return (Use("map", prints=("altitude = ",)), Use(command, channels, body, holds=holds))


HEIGHT, ISA_HEIGHT, COAST = 'altitude = "h"', 'altitude = "h_isa"', "--from 5.3 --to 27"
USES: dict[str, tuple[Use, ...]] = {
    "cavour_ballistic.csv": fall(
        "--from 44", HEIGHT, falling(1.225, 250.0), ("beta", 290.0, 325.0)
    ),
    "prometheus_telemega.csv": fall(
        COAST, ISA_HEIGHT, falling(1.0, 2000.0), ("beta", 2300.0, 2900.0)
    ),
    "prometheus_telemetrum.csv": fall(
        COAST, ISA_HEIGHT, falling(1.0, 2000.0), ("beta", 2300.0, 2900.0)
    ),
    "hedy_ascent.csv": fall(
        "--from 10 --to 25", HEIGHT, falling(1.2, 3000.0), ("beta", 1000.0, 4000.0)
    ),
    # A meteor falls at 15 degrees and the model vertically: it is read, and no parameter is
    # determined.
    "dfn_DN150417_fireball.csv": fall("", HEIGHT, falling(1.75, 500.0, 6900.0)),
    # Its column of pressure says that the altitude is in m up to the apogee.
    "logs/juno3.csv": fall("--from 7 --to 24", "", falling(1.05, 3000.0), ("beta", 3500.0, 5000.0)),
    "logs/ship_zz20.dat": (
        Use("map", prints=("4481 rows of 11 columns", "time = 1")),
        Use(
            "identify FILE --columns time,x,y,roll,psi,u,v,w,r,rudder,rpm",
            SHIP,
            model=NOMOTO,
            prints=("few digits",),
        ),
    ),
    "logs/heli_data.txt": (
        Use("map", prints=("no clock", "the file ends within row 605", "____Q,rad/s")),
        Use("maneuvers FILE --rate 10", HELICOPTER),
        Use("check FILE --rate 10", HELICOPTER),
    ),
    "logs/ddd_fw.csv": (
        Use("map", prints=("alpha_of", "airspeed")),
        Use("maneuvers FILE", FIXED_WING),
        Use("check FILE", FIXED_WING),
    ),
    "logs/px4_sample.ulg": (
        Use("map", prints=("a log of 15 topics", "sensor_combined.gyro_rad[1]")),
        Use(
            "identify FILE --rate 50",
            PX4_ROLL,
            model=ROLL,
            prints=("2 topics are put on one grid",),
        ),
        Use("check FILE", PX4_RATES),
    ),
    "logs/ardu_sample.bin": (
        Use("map", prints=("a log of 43 topics", "IMU.GyrY")),
        Use("check FILE", ARDUPILOT, prints=("2 records",)),
        Use("maneuvers FILE", ARDUPILOT),
    ),
    "aircraft/fAttasAil1.mat": attas("fAttasAil1"),
    "aircraft/fAttasRud1.mat": attas("fAttasRud1"),
    "aircraft/fAttasAilRud1.mat": attas("fAttasAilRud1"),
    "aircraft/fAttasAilRud2.mat": attas("fAttasAilRud2"),
    "aircraft/hfb320_1_10.asc": (
        Use("map", prints=("601 rows of 20 columns", "time = 1")),
        Use(
            "identify FILE --model longitudinal",
            HFB,
            HFB_VEHICLE,
            holds=(("Cm_alpha", -1.3, -0.5),),
        ),
        Use("maneuvers FILE", HFB),
    ),
    "aircraft/hfb320_1_10_withHeader.asc": (
        Use("map", prints=("ALFCG",)),
        Use(
            f"identify FILE --model longitudinal --columns {HFB_NAMES}",
            vehicle=HFB_VEHICLE,
            holds=(("Cm_alpha", -1.3, -0.5),),
        ),
    ),
    "aircraft/totter_lon_data.mat": (
        Use("map", prints=("* elevator (deg)", 'ax = {column = "* ax (g)", unit = "g"}')),
        Use(
            "identify FILE --model rigid",
            OTTER,
            OTTER_VEHICLE,
            holds=(("Cm_de", -2.2, -1.2), ("CL_alpha", 3.5, 6.5)),
        ),
        Use("maneuvers FILE", OTTER),
    ),
    "aircraft/compat_lon_example.mat": (Use("map", prints=("701 rows",)), Use("check FILE", HARV)),
    "aircraft/y13aus_da1.asc": (
        Use("map", prints=("321 rows",)),
        Use(
            "identify FILE",
            "time = 1\np = 5\nr = 6\naileron = 7\nrudder = 8\nv = 9",
            model=LATERAL,
            holds=(("L_p", -8.0, -4.0),),
        ),
    ),
    "aircraft/unStabAC_sim.asc": (
        Use("map", prints=("251 rows", "time = 1")),
        Use(
            "identify FILE --columns time,pilot,w,q,elevator,az",
            model=UNSTABLE,
            holds=(("M_de", -13.5, -12.0), ("M_w", 0.19, 0.24)),
        ),
    ),
    # The file's own model has a delay besides.
    "aircraft/fdoe_example.mat": (
        Use("map", prints=("5241 rows",)),
        Use(
            "identify FILE --method frequency-domain", model=SECOND_ORDER, holds=(("a0", 1.6, 2.2),)
        ),
    ),
    # A regression without a motion: it is opened, and no model of motion is in it.
    "aircraft/swr_example.mat": (Use("map", prints=("500 rows", "x1", "5 values for 500 times")),),
}


def test_every_file_has_a_use() -> None:
    present = {
        str(path.relative_to(FLIGHTDATA))
        for path in FLIGHTDATA.rglob("*")
        if path.is_file() and path.name not in NO_RECORDS
    }
    assert present <= set(USES)
    assert all(len(uses) <= 3 for uses in USES.values())


@pytest.mark.sampled
@pytest.mark.parametrize("name", [pytest.param(name, id=name.replace("/", "-")) for name in USES])
def test_a_file_is_used_as_its_owner_would(
    flightid: CommandLine, tmp_path: Path, name: str
) -> None:
    path = FLIGHTDATA / name
    if not path.is_file():
        pytest.skip(f"{name} is not here")
    for number, use in enumerate(USES[name]):
        command, *options = use.command.split()
        options = [str(path) if word == "FILE" else word for word in options]
        if command == "map":
            printed = flightid.done("map", path)
            assert all(word in printed for word in use.prints), printed
            continue
        for option, suffix, text in (
            ("--channels", "toml", use.channels),
            ("--vehicle", "toml", use.vehicle),
            ("--model", "py", use.model),
        ):
            if text:
                file = tmp_path / f"{option[2:]}{number}.{suffix}"
                file.write_text(text)
                options += [option, str(file)]
        if use.refused:
            assert use.refused in flightid.refused(command, *options, "--no-figures")
            continue
        out = tmp_path / f"study{number}"
        printed = flightid.done(command, *options, "--no-figures", "--out", out)
        written = next(out.glob("*.toml" if command == "maneuvers" else "co*.json")).read_text()
        assert all(word in printed + written for word in use.prints), printed
        for parameter, least, most in use.holds:
            found = json.loads(written)["parameters"][parameter]["estimate"]
            assert least < found < most, (parameter, found)
