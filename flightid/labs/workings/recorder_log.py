"""Example of lab 7: two flights of a small flying wing with an angle-of-attack vane, as a log.

ArduPilot's binary format (DataFlash), by its documentation: each message has a head (bytes 0xA395
and the number of its kind) and packed fields; FMT messages declare the kinds.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sim.maneuvers import Maneuver
    from sim.record import Record

CONSTANTS = {
    "mass": 3.2,
    "wing_area": 0.62,
    "chord": 0.3,
    "pitch_inertia": 0.18,
    "airspeed": 18.0,
    "air_density": 1.2,
}
TRUE = {"CL_alpha": 4.8, "CL_q": 7.0, "CL_de": 0.3, "Cm_alpha": -0.9, "Cm_q": -14.0, "Cm_de": -1.1}
STARTS = {
    "CL_alpha": 4.0,
    "CL_q": 5.0,
    "CL_de": 0.4,
    "Cm_alpha": -0.7,
    "Cm_q": -11.0,
    "Cm_de": -0.9,
}
DELAY = 0.06  # s, from the recorded pulse to the surface; the lab hides it
RATE, DURATION = 50.0, 16.0  # samples a second, s
NOISE = {"alpha": 0.0026, "q": 0.0052, "nz": 0.03}
BOOT = 41.0  # s from the start of the clock to that of the flight
PULSE = 573.0  # microseconds of a servo pulse for a radian of elevon
CENTRES = {"C1": 1500.0, "C2": 1510.0}  # microseconds; C1, the left elevon, is reversed
GRAVITY = 9.80665  # m/s2
MAP = """# the left elevon, C1, is reversed
elevator = "0.5*(pwm(RCOU.C2, 1510, 573) - pwm(RCOU.C1, 1500, 573))"
alpha = {column = "AOA.AOA", unit = "deg"}
q = "IMU.GyrY"
nz = {column = "-IMU.AccZ / 9.80665", unit = "g"}
"""


def vehicle_text() -> str:
    """Return the vehicle file of the flying wing, whose starting values are up to 30 % off."""
    lines = ['name = "flying wing"', *(f"{name} = {value}" for name, value in CONSTANTS.items())]
    return "\n".join([*lines, "[derivatives]", *(f"{n} = {v}" for n, v in STARTS.items())]) + "\n"


@cache
def flights() -> tuple[Record, Record]:
    """Return the two flights: time s, elevator, alpha and q in radians, nz in g from trim."""
    from sim.maneuvers import doublet, sequence, three_two_one_one

    first = [three_two_one_one(0.06, 0.24), doublet(-0.05, 0.4), doublet(0.05, 0.2)]
    second = [doublet(-0.06, 0.3), three_two_one_one(-0.05, 0.2), doublet(0.05, 0.5)]
    return (
        _flown(sequence(first, gap=3.0, start=1.0), 11),
        _flown(sequence(second, gap=3.0, start=1.0), 12),
    )


def _flown(maneuver: Maneuver, seed: int) -> Record:
    from sim.effects.input_path.input_delay import InputDelay
    from sim.truth.flight import fly, sample_times
    from sim.truth.measurement import Measurement
    from sim.vehicles.factory import model_from_constants

    model = model_from_constants("rigid", CONSTANTS, TRUE).with_effects(InputDelay("elevator"))
    record, _ = fly(
        model.with_values({"input-delay.delay": DELAY}),
        {"elevator": maneuver},
        sample_times(RATE, DURATION),
        np.random.default_rng(seed),
        measurement=Measurement(std=NOISE),
        outputs=("alpha", "q", "nz"),
    )
    return record


def example() -> tuple[tuple[str, bytes], ...]:
    """Return the two logs: name and content."""
    first, second = flights()
    return ("00000041.BIN", dataflash(first)), ("00000042.BIN", dataflash(second))


def dataflash(record: Record) -> bytes:
    """Return a flight as a DataFlash log of the messages IMU, AOA and RCOU.

    Angles of attack are degrees, rates rad/s, accelerations m/s2, and the two elevons whole
    microseconds of their servos' pulses.
    """
    row = {channel.name: channel.values for channel in record.channels}
    stamp = np.round(1e6 * (BOOT + record.time))
    pulse = PULSE * row["elevator"]
    zero = np.zeros(stamp.size)
    kinds: dict[str, tuple[str, dict[str, np.ndarray]]] = {
        "IMU": (
            "QBffffff",
            {
                "TimeUS": stamp,
                "I": zero,
                "GyrX": zero,
                "GyrY": row["q"],
                "GyrZ": zero,
                "AccX": zero,
                "AccY": zero,
                "AccZ": -GRAVITY * (1.0 + row["nz"]),
            },
        ),
        "AOA": ("Qff", {"TimeUS": stamp, "AOA": np.degrees(row["alpha"]), "SSA": zero}),
        "RCOU": (
            "QHH",
            {"TimeUS": stamp, "C1": CENTRES["C1"] - pulse, "C2": CENTRES["C2"] + pulse},
        ),
    }
    out = [_declared(128, "FMT", "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])]
    messages = []
    for number, (name, (form, columns)) in enumerate(kinds.items(), start=1):
        out.append(_declared(number, name, form, list(columns)))
        messages.append(_packed(number, form, columns))
    # A recorder writes as time goes: the messages of one instant follow each other.
    return b"".join([*out, *(each for instant in zip(*messages, strict=True) for each in instant)])


def _declared(kind: int, name: str, form: str, columns: list[str]) -> bytes:
    """Return a message FMT: number, length, name, format and columns of a kind of message."""
    sizes = {"Q": 8, "B": 1, "H": 2, "f": 4, "n": 4, "N": 16, "Z": 64}
    length = 3 + sum(sizes[letter] for letter in form)
    head = b"\xa3\x95" + bytes([128])
    text = ",".join(columns).encode()
    return head + struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), text)


def _packed(kind: int, form: str, columns: dict[str, np.ndarray]) -> list[bytes]:
    """Return the messages of one kind, one a sample."""
    whole = {
        name: values if letter == "f" else np.round(values).astype(np.int64)
        for letter, (name, values) in zip(form, columns.items(), strict=True)
    }
    head = b"\xa3\x95" + bytes([kind])
    rows = zip(*(values.tolist() for values in whole.values()), strict=True)
    return [head + struct.pack(f"<{form}", *row) for row in rows]
