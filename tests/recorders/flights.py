"""One simulated flight of a small aircraft as each kind of recorder stores it: the synthetic twins
of real logs.

The flight is integrated here, apart from the project's own equations, so that what is identified
from it can be compared with the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.recorders.forms import DEGREE
from tests.recorders.logs import write_dataflash, write_dataflash_text, write_ulog

TRUTH = {"CL_alpha": 4.8, "CL_q": 7.0, "CL_de": 0.3, "Cm_alpha": -0.9, "Cm_q": -14.0, "Cm_de": -1.1}
MASS, AREA, CHORD, INERTIA, SPEED, DENSITY = 3.2, 0.62, 0.3, 0.18, 18.0, 1.2
VEHICLE = f"""# file: uav.toml
name = "elevon flying wing"
mass = {MASS}
wing_area = {AREA}
chord = {CHORD}
pitch_inertia = {INERTIA}
airspeed = {SPEED}
air_density = {DENSITY}
[derivatives]
CL_alpha = 4.0
CL_q = 5.0
CL_de = 0.4
Cm_alpha = -0.7
Cm_q = -11.0
Cm_de = -0.9
"""
RATE, STEPS, DURATION = 100.0, 10, 20.0


def steps(t: np.ndarray | float) -> np.ndarray:
    """An elevator of two 3-2-1-1, rad."""
    at = np.asarray(t)
    two = np.where(at < 10.0, at, at - 10.0)
    size = np.where(at < 10.0, 0.05, -0.04)
    return size * np.select([(two >= 1) & (two < 1.6), (two >= 1.6) & (two < 2.0), (two >= 2.0) & (two < 2.2), (two >= 2.2) & (two < 2.4)],  # noqa: E501
                            [1.0, -1.0, 1.0, -1.0], 0.0)  # fmt: skip


def sweep(t: np.ndarray | float) -> np.ndarray:
    """An elevator at rest, then two sweeps from 0.3 to 3 Hz of other sizes, rad."""
    at = np.asarray(t)
    two = np.where(at < 10.0, at, at - 10.0) - 1.0
    phase = 2.0 * np.pi * 0.3 * 8.0 / np.log(10.0) * (10.0 ** (two / 8.0) - 1.0)
    return np.where(
        (two >= 0.0) & (two <= 8.0), np.where(at < 10.0, 0.03, -0.02) * np.sin(phase), 0.0
    )


def flight(
    delay: float = 0.0,
    seed: int = 7,
    elevator: Callable[[np.ndarray | float], np.ndarray] = steps,
    swing: float = 0.0,
) -> dict[str, np.ndarray]:
    """Time, s, elevator, alpha, q in radians at 100 Hz, with noise.

    The surface follows the recorded elevator ``delay`` s late. With a ``swing`` the airspeed swings
    by so many m/s about its mean, with a period of 12 s, and is recorded, too.
    """
    rng = np.random.default_rng(seed)
    count = int(DURATION * RATE)
    time = np.arange(count) / RATE

    def speed_at(t: np.ndarray | float) -> np.ndarray:
        return np.asarray(SPEED + swing * np.sin(2.0 * np.pi * np.asarray(t) / 12.0))

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        speed = float(speed_at(t))
        q_bar_s = 0.5 * DENSITY * speed**2 * AREA
        q_hat, de = x[1] * CHORD / (2 * speed), float(elevator(t - delay))
        lift = TRUTH["CL_alpha"] * x[0] + TRUTH["CL_q"] * q_hat + TRUTH["CL_de"] * de
        moment = TRUTH["Cm_alpha"] * x[0] + TRUTH["Cm_q"] * q_hat + TRUTH["Cm_de"] * de
        # The lift that carries the weight grows with the dynamic pressure, the weight does not.
        excess = 9.80665 * (speed**2 / SPEED**2 - 1.0)
        return np.array(
            [
                x[1] - q_bar_s * lift / (MASS * speed) - excess / speed,
                q_bar_s * CHORD * moment / INERTIA,
            ]
        )

    x, h = np.zeros(2), 1.0 / RATE / STEPS
    states = np.zeros((count, 2))
    for row in range(count):
        states[row] = x
        for step in range(STEPS):
            t = row / RATE + step * h + 1e-12  # a step of the input takes hold at its own instant
            k1 = rates(t, x)
            k2 = rates(t + h / 2, x + h / 2 * k1)
            k3 = rates(t + h / 2, x + h / 2 * k2)
            k4 = rates(t + h - 2e-12, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    alpha = states[:, 0] + 0.15 * DEGREE * rng.standard_normal(count)
    q = states[:, 1] + 0.3 * DEGREE * rng.standard_normal(count)
    columns = {"time": time, "elevator": elevator(time + 1e-12), "alpha": alpha, "q": q}
    return columns | ({"airspeed": speed_at(time)} if swing else {})


def write_all(folder: Path) -> None:
    """The flight as ``uav.`` and ``ulg``, ``bin``, ``log``, ``xlsx``, ``mf4``, ``tdms``, ``h5``,
    ``mat``, ``txt`` and ``csv``; without a vane as ``novane.bin``.
    """
    columns = flight()
    px4(folder / "uav.ulg", columns)
    ardupilot(folder / "uav.bin", columns)
    without_vane(folder / "novane.bin", columns)
    ardupilot(folder / "uav.log", columns)
    _tables(folder, columns)


def px4(path: Path, columns: dict[str, np.ndarray], every: int = 1) -> Path:
    """A PX4 log: gyro at full rate, elevons, true airspeed and the angle of attack of a vane at
    every ``every``-th sample.
    """
    stamps = np.round(1e6 * (12.0 + columns["time"]))
    slow = slice(None, None, every)
    half = columns["elevator"][slow] / (30.0 * DEGREE)
    zero = 0.0 * stamps
    topics = {
        "vehicle_angular_velocity": {
            "timestamp": stamps,
            "xyz[0]": zero,
            "xyz[1]": columns["q"],
            "xyz[2]": zero,
        },
        "airspeed_validated": {
            "timestamp": stamps[slow],
            "true_airspeed_m_s": columns.get("airspeed", SPEED + zero)[slow],
        },
        "vane": {"timestamp": stamps[slow], "angle_of_attack": columns["alpha"][slow]},
        "actuator_servos": {
            "timestamp": stamps[slow],
            "control[0]": half + 0.05,
            "control[1]": half - 0.05,
        },
    }
    return write_ulog(path, topics)


def ardupilot(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A DataFlash log, a text one by the suffix ``.log``: two IMUs, angle of attack in degrees,
    servo pulses of elevons, the left one reversed."""
    stamps = np.round(1e6 * (12.0 + columns["time"]))
    angle = columns["elevator"] / DEGREE
    both = np.repeat(stamps, 2)
    messages = {
        "IMU": {
            "TimeUS": both,
            "I": np.tile([0.0, 1.0], stamps.size),
            "GyrY": np.repeat(columns["q"], 2),
        },
        "AOA": {"TimeUS": stamps, "AOA": columns["alpha"] / DEGREE},
        "RCOU": {"TimeUS": stamps, "C1": 1500.0 - 10.0 * angle, "C2": 1510.0 + 10.0 * angle},
    }
    units = {"IMU": "s#E", "AOA": "sd"}
    if "airspeed" in columns:
        messages["ARSP"], units["ARSP"] = {"TimeUS": stamps, "Airspeed": columns["airspeed"]}, "sn"
    write = write_dataflash_text if path.suffix == ".log" else write_dataflash
    return write(path, messages, units)


def without_vane(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A DataFlash log with one IMU and the servo pulses, and no angle of attack.

    The accelerometer is in the centre of gravity. It reads the lift of the noisy alpha and q, so
    that its error is 0.3 m/s2.
    """
    stamps = np.round(1e6 * (12.0 + columns["time"]))
    angle = columns["elevator"] / DEGREE
    q_hat = columns["q"] * CHORD / (2.0 * SPEED)
    lift = (
        TRUTH["CL_alpha"] * columns["alpha"]
        + TRUTH["CL_q"] * q_hat
        + TRUTH["CL_de"] * columns["elevator"]
    )
    down = -9.80665 - 0.5 * DENSITY * SPEED**2 * AREA * lift / MASS
    messages = {
        "IMU": {"TimeUS": stamps, "GyrY": columns["q"], "AccZ": down},
        "RCOU": {"TimeUS": stamps, "C1": 1500.0 - 10.0 * angle, "C2": 1510.0 + 10.0 * angle},
    }
    return write_dataflash(path, messages, {"IMU": "sEo"})


def _tables(folder: Path, columns: dict[str, np.ndarray]) -> None:
    import h5py
    import pandas
    from asammdf import MDF, Signal
    from nptdms import ChannelObject, TdmsWriter
    from scipy.io import savemat

    degrees = {name: values / DEGREE for name, values in columns.items() if name != "time"}
    sheet = {
        "Time (s)": columns["time"],
        "DELV (deg)": degrees["elevator"],
        "AoA (deg)": degrees["alpha"],
        "Pitch rate (deg/s)": degrees["q"],
    }
    pandas.DataFrame(sheet).to_excel(folder / "uav.xlsx", index=False)
    with MDF() as log:
        units = {"elevator": "deg", "alpha": "deg", "q": "deg/s"}
        log.append(
            [
                Signal(degrees[name], columns["time"], name=name, unit=unit)
                for name, unit in units.items()
            ]
        )
        log.save(folder / "uav.mf4", overwrite=True)
    with TdmsWriter(str(folder / "uav.tdms")) as writer:
        told = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0}
        names = {"elevator": "deg", "alpha": "deg", "q": "deg/s"}
        writer.write_segment(
            [
                ChannelObject("flight", name, degrees[name], {**told, "unit_string": unit})
                for name, unit in names.items()
            ]
        )
    with h5py.File(folder / "uav.h5", "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"flight/{name}", data=values)
    savemat(
        folder / "uav.mat",
        {"Z": np.column_stack([columns[name] for name in ("time", "elevator", "alpha", "q")])},
    )
    np.savetxt(
        folder / "uav.txt",
        np.column_stack([degrees["elevator"], degrees["alpha"], degrees["q"]]),
        fmt="%12.6f",
    )
    lines = ["# ground station, exported", "UTC;Elevator [deg];Alpha [deg];Q [deg/s]"]
    lines += [
        f"12:{59 + int(t // 60):02d}:{t % 60:06.3f};{a:.6f};{b:.6f};{c:.6f}"
        for t, a, b, c in zip(columns["time"], *degrees.values(), strict=True)
    ]
    (folder / "uav.csv").write_text("\n".join(lines).replace(".", ",") + "\n", encoding="latin-1")
