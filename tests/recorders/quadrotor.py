"""A simulated quadrotor under a rate controller, as PX4 and ArduPilot log it: the synthetic twins
of real multirotor logs.

The flight is integrated here, apart from the project's own equations: exact steps of a linear
system between events of the motors' commands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.linalg import expm

from tests.recorders.forms import DEGREE
from tests.recorders.logs import write_dataflash, write_ulog

TRUTH = {
    **{"L_p": -2.0, "L_lat": 95.0, "L_0": 1.9},
    **{"M_q": -1.6, "M_lon": 80.0, "M_0": -2.4},
    **{"N_r": -0.7, "N_ped": 18.0, "N_0": 0.36},
    **{"Z_col": -26.0, "Z_0": 0.4},
    **{"motor_time_constant": 0.045, "delay": 0.014},
}
STARTS = {
    **{"L_p": -1.0, "L_lat": 70.0, "L_0": 0.0},
    **{"M_q": -1.0, "M_lon": 70.0, "M_0": 0.0},
    **{"N_r": -1.0, "N_ped": 15.0, "N_0": 0.0},
    **{"Z_col": -20.0, "Z_0": 0.0},
    **{"motor_time_constant": 0.03, "delay": 0.01},
}
_LINES = "\n".join(f"{name} = {value}" for name, value in STARTS.items())
VEHICLE = f"""# file: quad.toml
name = "quadrotor"
[derivatives]
{_LINES}
"""
RATE, DURATION = 100.0, 26.0
AXES = (
    ("L_p", "L_lat", "L_0", "p", "roll"),
    ("M_q", "M_lon", "M_0", "q", "pitch"),
    ("N_r", "N_ped", "N_0", "r", "yaw"),
)
GAINS = (0.11, 0.12, 0.25)  # command per rad/s of error
NOISE = {"p": 0.3 * DEGREE, "q": 0.3 * DEGREE, "r": 0.2 * DEGREE, "az": 0.15}
HOVER = 0.39
FINE = 1e-3  # s, of the rates that a late gyro looks back to


def wanted(axis: int, time: float) -> float:
    """The pilot's rate, rad/s: a 3-2-1-1 on each axis in turn, then a doublet."""
    size, unit = (1.2, 1.2, 0.6)[axis], (0.25, 0.25, 0.5)[axis]
    for start, sign in ((1.0 + 6.0 * axis, 1.0), (20.0 + 2.0 * axis, -1.0)):
        ends = start + unit * np.cumsum(
            [0.0, 3.0, 2.0, 1.0, 1.0] if sign > 0.0 else [0.0, 1.0, 1.0]
        )
        for n in range(len(ends) - 1):
            if ends[n] - 1e-9 <= time < ends[n + 1] - 1e-9:
                return sign * size * (-1.0) ** n
    return 0.0


def flight(
    gyro_delay: float = 0.0, seed: int = 11, noise: float = 1.0, duration: float = DURATION
) -> dict[str, np.ndarray]:
    """Time, s, the four commands, p, q, r (rad/s) and az (m/s2) at 100 Hz; the controller and the
    log read p ``gyro_delay`` s late.

    A command that the controller makes of the gyro at a sample holds until the next; the motors
    feel it ``delay`` later.
    """
    rng, step = np.random.default_rng(seed), 1.0 / RATE
    count = int(duration * RATE)
    time = step * np.arange(count)
    whole, part = divmod(TRUTH["delay"], step)
    late = int(whole) + (part > 1e-9)
    commands, rates = np.zeros((4, count)), np.zeros((3, count))
    steady = [-TRUTH[constant] / TRUTH[gain] for _, gain, constant, _, _ in AXES]
    commands[3] = HOVER + 0.05 * np.sign(np.sin(2.0 * np.pi * time / 3.1)) * (time > 2.0)
    states = [np.array([0.0, u, 1.0, u]) for u in steady]  # rate, motor, one, command
    thrust = np.array([HOVER, HOVER])
    lifted = np.zeros(count)
    history = [[0.0] for _ in AXES]
    for row in range(count):
        for axis, gain in enumerate(GAINS):
            rates[axis, row] = (
                _late(history[axis], gyro_delay if axis == 0 else 0.0)
                + noise * NOISE["pqr"[axis]] * rng.standard_normal()
            )
            commands[axis, row] = steady[axis] + gain * (wanted(axis, time[row]) - rates[axis, row])
        lifted[row] = thrust[0]
        before, after = row - late, row - late + 1
        for span, index in ((part, before), (step - part, after if part > 1e-9 else before)):
            for axis, names in enumerate(AXES):
                states[axis][3] = commands[axis, max(index, 0)] if index >= 0 else commands[axis, 0]
                history[axis] += _advance(states[axis], names, span)
            thrust[1] = commands[3, max(index, 0)]
            thrust[0] = thrust[1] + (thrust[0] - thrust[1]) * np.exp(
                -span / TRUTH["motor_time_constant"]
            )
    az = TRUTH["Z_0"] + TRUTH["Z_col"] * lifted + noise * NOISE["az"] * rng.standard_normal(count)
    called = ("roll_command", "pitch_command", "yaw_command", "thrust_command")
    return {
        "time": time,
        **dict(zip(called, commands, strict=True)),
        "p": rates[0],
        "q": rates[1],
        "r": rates[2],
        "az": az,
    }


def _late(history: list[float], delay: float) -> float:
    back = round(delay / FINE)
    return history[-1 - back] if back < len(history) else history[0]


def _advance(state: np.ndarray, names: tuple[str, ...], span: float) -> list[float]:
    """Move rate and motor on by ``span`` s under a constant command, in milliseconds; the rates on
    the way.
    """
    damping, gain, constant = (TRUTH[name] for name in names[:3])
    lag = TRUTH["motor_time_constant"]
    slopes = np.array(
        [[damping, gain, constant, 0.0], [0.0, -1.0 / lag, 0.0, 1.0 / lag], [0.0] * 4, [0.0] * 4]
    )
    once, seen = expm(slopes * FINE), []
    for _ in range(round(span / FINE)):
        state[:] = once @ state
        seen.append(float(state[0]))
    return seen


def px4(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A PX4 log of a multirotor: torque and thrust setpoints (thrust down), gyro and
    accelerometer.
    """
    stamps = np.round(1e6 * (12.0 + columns["time"]))
    zero = 0.0 * stamps
    topics = {
        "vehicle_angular_velocity": {
            "timestamp": stamps,
            "xyz[0]": columns["p"],
            "xyz[1]": columns["q"],
            "xyz[2]": columns["r"],
        },
        "vehicle_acceleration": {
            "timestamp": stamps,
            "xyz[0]": zero,
            "xyz[1]": zero,
            "xyz[2]": columns["az"],
        },
        "vehicle_torque_setpoint": {
            "timestamp": stamps,
            **{f"xyz[{n}]": columns[f"{axis[4]}_command"] for n, axis in enumerate(AXES)},
        },
        "vehicle_thrust_setpoint": {
            "timestamp": stamps,
            "xyz[0]": zero,
            "xyz[1]": zero,
            "xyz[2]": -columns["thrust_command"],
        },
        "vehicle_status": {"timestamp": stamps[::100], "vehicle_type": 1.0 + zero[::100]},
    }
    return write_ulog(path, topics)


def ardupilot(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A DataFlash log of a multirotor: one IMU, and the rate controller's outputs."""
    stamps = np.round(1e6 * (12.0 + columns["time"]))
    zero = 0.0 * stamps
    rate = {
        "ROut": "roll_command",
        "POut": "pitch_command",
        "YOut": "yaw_command",
        "AOut": "thrust_command",
    }
    gyro = {"GyrX": columns["p"], "GyrY": columns["q"], "GyrZ": columns["r"]}
    messages = {
        "IMU": {"TimeUS": stamps, **gyro, "AccX": zero, "AccY": zero, "AccZ": columns["az"]},
        "RATE": {"TimeUS": stamps, **{name: columns[channel] for name, channel in rate.items()}},
    }
    return write_dataflash(path, messages, {"IMU": "sEEEooo", "RATE": "s----"})


def write_all(folder: Path) -> None:
    """The flight as ``quad.ulg`` and ``quad.bin``, and one whose roll gyro is 30 ms late as
    ``late.ulg``.
    """
    columns = flight()
    px4(folder / "quad.ulg", columns)
    ardupilot(folder / "quad.bin", columns)
    px4(folder / "late.ulg", flight(gyro_delay=0.03, seed=12))


def by_hand(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """The same as a table with the project's own names."""
    rows = [
        ",".join(columns),
        *(
            ",".join(repr(float(value)) for value in row)
            for row in zip(*columns.values(), strict=True)
        ),
    ]
    path.write_text("\n".join(rows) + "\n")
    return path
