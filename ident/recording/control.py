"""The pitch acceleration that a recorded control makes: its sign and size against what the vehicle's data say.

q(t + h) - q(t) = M_alpha int alpha dt + M_q int q dt + M_delta int delta(t - late) dt + c h, by least squares; nz stands in for an absent alpha.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.recording.motion import Columns, change, integral, lag_of

LATE = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.25, 0.3)  # s, delays and lags of controls
SURE = 8.0  # standard deviations; one lag for one sample is a rough count of what is independent
EXPLAINED = 0.8  # share of q's change: 0.79 at least in a hundred records with any effect of the library
RIVALLED = 0.25  # of what the other sign leaves: at 10 samples a second 0.37 of a light aircraft with the wrong sign, at 50 0.1 with the right one
RESOLVED = 4  # rows of one lag: with fewer, a pulse that begins between two of them is worth as much as what the control does
FEWEST = 12  # independent stretches of one lag


@dataclass(frozen=True)
class ControlPower:
    """M_delta (rad/s2 per unit) with a standard deviation of as many samples as there are lags, and the share of q's change that the fit explains.

    ``opposed`` : the largest share that a fit of the other sign explains, at another lateness of the control.
    ``damped`` : the fit's M_q is negative, as of any aircraft.
    """

    value: float
    std: float
    explained: float
    opposed: float = 0.0
    damped: bool = True


def control_power(columns: Columns) -> ControlPower | None:
    """M_delta of the columns; None where q, a control or a second output is not there, or too little of it."""
    y = columns.outputs
    partner = next((name for name in ("alpha", "nz") if name in y), None)
    if columns.control is None or "q" not in y or partner is None:
        return None
    lag = lag_of(columns)
    left = change(y["q"], lag)
    if lag < RESOLVED or len(left) // lag < FEWEST:
        return None
    sums = [change(integral(columns.time, y[name] - np.mean(y[name])), lag) for name in (partner, "q")]
    moved = np.concatenate([[0.0], np.cumsum((columns.control - np.mean(columns.control))[:-1] * np.diff(columns.time))])
    found = [fitted for late in LATE if (fitted := _fitted(left, sums, change(_late(columns.time, moved, late), lag), lag)) is not None]
    if not found:
        return None
    best = max(found, key=lambda one: one.explained)
    return replace(best, opposed=max((one.explained for one in found if one.value * best.value < 0.0), default=0.0))


def sure(found: ControlPower) -> bool:
    """Whether sign and size of a control power can be relied on.

    A few samples of a fast motion are explained as well by a control that is late by half its period and works the other way,
    or by a motion that pitching feeds: of 1200 sound light aircraft at 8 to 50 samples a second one was told a turned sign so.
    """
    unrivalled = 1.0 - found.explained < RIVALLED * (1.0 - found.opposed)
    return found.damped and abs(found.value) > SURE * found.std and found.explained > EXPLAINED and unrivalled


def _fitted(left: np.ndarray, sums: list[np.ndarray], moved: np.ndarray, lag: int) -> ControlPower | None:
    rows = np.stack([*sums, moved, np.ones(len(left))])
    scale = np.sqrt(np.mean(rows**2, axis=1))
    if np.min(scale) <= 0.0:
        return None
    unit = rows / scale[:, None]
    gram = unit @ unit.T
    if np.linalg.cond(gram) > 1e10:
        return None
    inverse = np.linalg.inv(gram)
    coefficients = inverse @ (unit @ left)
    off = left - coefficients @ unit
    power = float(np.sum((left - np.mean(left)) ** 2))
    if power <= 0.0:
        return None
    variance = float(off @ off) / len(left) * lag
    return ControlPower(
        float(coefficients[2] / scale[2]),
        max(float(np.sqrt(variance * inverse[2, 2]) / scale[2]), 1e-300),
        1.0 - float(off @ off) / power,
        damped=bool(coefficients[1] < 0.0),
    )


def _late(time: np.ndarray, moved: np.ndarray, late: float) -> np.ndarray:
    return moved if late == 0.0 else np.interp(time - late, time, moved)
