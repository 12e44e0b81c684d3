"""A channel that jumps within one sample and stays, while no input and no other channel jumps.

At each row a straight line through the samples before and one through those after are extrapolated to the middle between them; their
difference forgets a level, a slope and a curvature. What inputs and other channels explain of it, by least squares, is taken off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number, shown
from ident.recording.series import Series
from ident.statistics.robust import robust_sigma_about_zero

REACH = 0.25  # s, of either line: a quarter of a quick short period
FEWEST, MOST = 5, 25  # samples of a line
# Standard deviations: the extreme of 3000 correlated Gaussian rows is 4.5; motion that lines do not follow makes the tails of a clean record longer.
SURE = 8.0
ABOVE_ITS_SURROUNDINGS = 3.0  # times the largest elsewhere within SURROUNDINGS, where the motion is as lively
SURROUNDINGS = 1.0  # s
OTHERS_QUIET = 4.0  # standard deviations that no other channel's jump exceeds at that row
INPUT_QUIET = 0.05  # of an input's span
INPUT_APART = 0.6  # of a line's length, to which a step of an input must keep: kinks are followed to first order only
PARTNER = 0.7  # of a jump: one of the other sign within two windows makes it a bump; a step by itself has side lobes of 0.35
CORNER, CORNER_REACH = 4.0, 0.8  # standard deviations; s on either side of a jump of nz
MANY = 3  # jumps told of one channel


def zero_steps(
    series: Sequence[Series], inputs: Sequence[Series], masked: Mapping[str, np.ndarray], gravity_over_speed: float | None = None
) -> list[Finding]:
    """Jumps of single channels, a warning each; ``masked``: by channel the rows that are masked already. ``gravity_over_speed`` in 1/s:

    with it a jump of nz is known for a load where the path of alpha bends as a load bends it.
    """
    if not series or len(series[0].values) < 4 * FEWEST:
        return []
    step = float(np.median(np.diff(series[0].time)))
    length = int(np.clip(round(REACH / step), FEWEST, MOST))
    rows = np.unique(np.concatenate([each.rows for each in series]))
    if len(rows) < 6 * length:
        return []
    values = {each.name: _filtered(each, rows, masked.get(each.name)) for each in (*series, *inputs)}
    jumps = {name: _jumps(column, length) for name, column in values.items()}
    # A step of the control is a kink of the pitch rate: the input's sum goes beside it.
    driven = [_jumps(np.cumsum(values[each.name] - np.mean(values[each.name])), length) for each in inputs]
    weight = float(np.sqrt(2.0 * np.sum(_weights(length) ** 2)))
    quiet = {each.name: max(weight * each.noise + each.least_bit, _usual(jumps[each.name])) for each in series}
    still = _still([values[each.name] for each in inputs], len(rows), round(INPUT_APART * length))
    out = []
    for each in series:
        left = _unexplained(jumps[each.name], [*(jumps[name] for name in jumps if name != each.name), *driven])
        for at in _peaks(left, weight * each.noise + each.least_bit, length, round(min(SURROUNDINGS / step, len(left)))):
            near = slice(max(0, at - 2), at + 3)
            calm = all(np.max(np.abs(jumps[other.name][near])) < OTHERS_QUIET * quiet[other.name] for other in series if other is not each)
            if each.name == "nz" and _is_load(series, values, rows[at + length], float(left[at]), gravity_over_speed):
                continue
            if calm and still[at + length] and not _touches(masked.get(each.name), rows[at : at + 2 * length]):
                out.append(_finding(each, rows[at + length], float(left[at])))
    return out


def _is_load(series: Sequence[Series], values: Mapping[str, np.ndarray], row: int, size: float, gravity_over_speed: float | None) -> bool:
    """If alpha - int (q - (g/V) nz) dt goes straight through a jump of nz, as it does where the jump is a load; a zero that steps makes a corner.

    The corner is told where it would be ``CORNER`` standard deviations of the noise of alpha.
    """
    known = {each.name: each for each in series}
    time = known["nz"].time
    if gravity_over_speed is None or not {"alpha", "q"} <= set(known) or len(time) != len(values["nz"]):
        return False
    at = time[np.searchsorted(known["nz"].rows, row)]
    near = np.abs(time - at) < CORNER_REACH
    t = time[near] - at
    rate = (values["q"] - gravity_over_speed * (values["nz"] - np.mean(values["nz"])))[near]
    path = values["alpha"][near] - np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    matrix = np.stack([np.ones(len(t)), t, np.maximum(t, 0.0)])
    inverse = np.linalg.pinv(matrix @ matrix.T)
    corner, std = float((inverse @ (matrix @ path))[2]), known["alpha"].noise * float(np.sqrt(inverse[2, 2]))
    expected = abs(gravity_over_speed * size)
    return expected > CORNER * std and abs(corner) < 0.5 * expected


def _still(inputs: Sequence[np.ndarray], count: int, apart: int) -> np.ndarray:
    """Rows at which no input steps within ``apart`` rows."""
    steps = np.zeros(count)
    for values in inputs:
        steps[1:-1] += np.abs(np.diff(values, 2)) > INPUT_QUIET * float(np.ptp(values))
    return np.asarray(np.convolve(steps, np.ones(2 * apart + 3), mode="same") < 0.5)


def _finding(series: Series, row: int, size: float) -> Finding:
    time = float(series.time[min(int(np.searchsorted(series.rows, row)), len(series.time) - 1)])
    load = ", or a load did that nothing recorded" if series.name in ("nz", "az") else ""
    told = f"jumps by {shown(size, series.unit)} at {time:.4g} s and stays, while no input and no other channel jumps: its zero stepped{load}"
    numbers = {"time": Number(time, "s"), "step": Number(size, series.unit)}
    remedy = "give the parts before and after as segments, --from and --to in pairs"
    return Finding(series.name, Kind.ZERO_STEP, Certainty.LIKELY, told, remedy, ((time, time),), numbers)


def _filtered(series: Series, rows: np.ndarray, masked: np.ndarray | None) -> np.ndarray:
    """A channel on common rows, gaps and masked samples bridged, lone wrong samples taken out by a median of three."""
    good = np.ones(len(series.rows), dtype=bool) if masked is None else ~masked[series.rows]
    if np.count_nonzero(good) < 2:
        return np.zeros(len(rows))
    values = np.interp(rows, series.rows[good], series.values[good])
    return np.concatenate([values[:1], np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0), values[-1:]])


def _weights(length: int) -> np.ndarray:
    """Of samples at 0.5, 1.5, ... in the value at 0 of the straight line through them."""
    position = np.arange(length) + 0.5
    matrix = np.stack([np.ones(length), position])
    return np.asarray(np.linalg.solve(matrix @ matrix.T, matrix)[0])


def _jumps(values: np.ndarray, length: int) -> np.ndarray:
    """Line after less line before, between rows ``k + length - 1`` and ``k + length``, for every k."""
    weights = _weights(length)
    kernel = np.concatenate([-weights[::-1], weights])
    return np.asarray(np.correlate(values, kernel, mode="valid"))


def _unexplained(jump: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """What other channels' jumps do not explain, by least squares without the largest."""
    moving = [other for other in others if np.any(other)]
    if not moving:
        return jump
    rows = np.stack(moving).T
    keep = np.ones(len(jump), dtype=bool)
    left = jump
    for _ in range(2):
        coefficients = np.linalg.lstsq(rows[keep], jump[keep], rcond=None)[0]
        left = jump - rows @ coefficients
        keep = np.abs(left) < 4.0 * _usual(left)
        if np.count_nonzero(keep) < 4 * rows.shape[1]:
            break
    return np.asarray(left)


def _usual(jump: np.ndarray) -> float:
    return max(robust_sigma_about_zero(jump), 1e-300)


def _peaks(left: np.ndarray, noise: float, length: int, around: int) -> list[int]:
    """Rows of jumps that stand above the noise and their surroundings and have no partner of the other sign."""
    size = np.abs(left)
    out: list[int] = []
    least = SURE * max(_usual(left), noise)
    taken = np.zeros(len(left), dtype=bool)
    for at in np.argsort(size)[::-1][: 20 * MANY]:
        if size[at] < least or len(out) > MANY:
            break
        if taken[at]:
            continue
        taken[max(0, at - 2 * length) : at + 2 * length + 1] = True
        near = slice(max(0, at - 2 * length), at + 2 * length + 1)
        opposite = float(np.max(-np.sign(left[at]) * left[near]))
        away = np.concatenate([size[max(0, at - around - length) : max(0, at - length)], size[at + length + 1 : at + length + around + 1]])
        if opposite < PARTNER * size[at] and (not away.size or size[at] > ABOVE_ITS_SURROUNDINGS * float(np.max(away))):
            out.append(int(at))
    return out if len(out) <= MANY else []


def _touches(masked: np.ndarray | None, rows: np.ndarray) -> bool:
    return masked is not None and bool(np.any(masked[rows]))
