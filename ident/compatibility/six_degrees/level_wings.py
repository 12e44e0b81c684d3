"""Records without a bank angle: the wings are taken as level, unless the rates of roll and yaw say that this would mislead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import BIAS, SensorFault
from sim.record import Record

LEVEL = "no bank angle is recorded: the wings are taken as level"
_RATES = ("p", "r")


def misled_by_bank(records: Sequence[Record], airspeed: float | None, gravity: float) -> tuple[str, ...]:
    """A sentence on each record in which level wings would mislead the relations of alpha and theta; ``airspeed`` (m/s) where none is recorded.

    Of p the integral about its median is the bank, of r the bank of a coordinated turn. What such a bank would add to the integrals of
    theta and alpha, less a constant and a trend, which starts and biases take, is more than the size from which a bias is worth a word.
    """
    out = []
    for record in records:
        rates = [name for name in _RATES if name in record.output_names and np.count_nonzero(record[name].valid) > 1]
        if "phi" in record.output_names or "q" not in record.output_names or not rates:
            continue
        phi = _bank(record, rates, airspeed, gravity)
        worst = max(np.std(_left(record.time, wrong)) for wrong in _wrong_rates(record, rates, phi, airspeed, gravity))
        if worst > SensorFault("alpha", BIAS).worth:
            lean, say = np.degrees(np.max(np.abs(phi))), "say" if len(rates) > 1 else "says"
            out.append(
                f"no bank angle is recorded in {record.name}, and {' and '.join(rates)} {say} that the wings were up to {lean:.0f} deg from level: "
                "nothing is told of alpha, q, theta and the loads, whose relations need it"
            )
    return tuple(out)


def _bank(record: Record, rates: Sequence[str], airspeed: float | None, gravity: float) -> np.ndarray:
    """About the bank angle ``(N,)``, rad."""
    turn = np.zeros(len(record))
    speed = _speed(record, airspeed)
    if "r" in rates and speed is not None:
        turn = np.arctan(_filled(record, "r") * speed / gravity)
    if "p" not in rates:
        return turn
    p = _filled(record, "p")
    rolled = _integral(record.time, p - np.median(p))
    return np.asarray(rolled - np.median(rolled) + np.median(turn))


def _wrong_rates(record: Record, rates: Sequence[str], phi: np.ndarray, airspeed: float | None, gravity: float) -> tuple[np.ndarray, ...]:
    """By what level wings are wrong in the rates of theta and, where an airspeed is known, of alpha."""
    speed = _speed(record, airspeed)
    q = _filled(record, "q") if "q" in record.output_names else np.zeros(len(record))
    r = _filled(record, "r") if "r" in rates else np.tan(phi) * (gravity / speed if speed is not None else 0.0)
    pitch = q * (np.cos(phi) - 1.0) - r * np.sin(phi)
    return (pitch,) if speed is None else (pitch, gravity / speed * (np.cos(phi) - 1.0))


def _speed(record: Record, airspeed: float | None) -> float | None:
    if "airspeed" in record.output_names:
        return float(np.nanmean(np.where(record["airspeed"].valid, record["airspeed"].values, np.nan)))
    return airspeed


def _filled(record: Record, name: str) -> np.ndarray:
    channel = record[name]
    return np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])


def _integral(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])


def _left(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The integral of a rate without its constant and trend."""
    whole = _integral(time, rate)
    return np.asarray(whole - np.polynomial.Polynomial.fit(time, whole, 1)(time))
