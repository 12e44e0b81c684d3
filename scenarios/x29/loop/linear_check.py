"""The flown loop against its linear one: python-control's forced response to the same stick, and what makes the two differ.

The flown loop has a break-out, a gearing that steepens, and surfaces that meet limits; the linear one has a gain and none of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.linear import respond
from sim.closed_loop.nonlinear import ClosedLoopTruth, FlightOutcome, fly_closed_loop

OUTPUTS = ("alpha", "q", "nz")
STICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)  # in, the largest of each scaled stick; the last asks for some 6 g
ROUNDING = 1e-9  # of the response: what two writings of one loop may differ by
NO_LIMIT = 1e6  # deg and deg/s
Change = Callable[[X29], X29]


@dataclass(frozen=True, eq=False)
class LinearCheck:
    """Misfits are root mean squares of flown minus linear over that of the linear response.

    Attributes
    ----------
    time : ``(F,)`` s, frames of the control computer.
    flown, linear : ``(3, F)``: alpha (rad), q (rad/s) and incremental nz (g), without noise.
    misfit : by output. apart : of q, with one departure from linearity left in at a time, and with none.
    stick : largest of the flown stick, in. sticks : largest of the same stick at other sizes, in.
    curves : misfit of q at ``sticks``, whole and with departures taken out; NaN where the aircraft departs.
    limited : share of the flown frames in which a command, a rate or a travel limit was met.
    """

    time: np.ndarray
    flown: np.ndarray
    linear: np.ndarray
    misfit: Mapping[str, float]
    apart: Mapping[str, float]
    stick: float
    sticks: tuple[float, ...]
    curves: Mapping[str, tuple[float, ...]]
    limited: float

    @property
    def same(self) -> bool:
        """Whether nothing but rounding is left without the departures from linearity."""
        return self.apart["none of these"] < ROUNDING


def linear_check(x29: X29, truth: ClosedLoopTruth) -> LinearCheck:
    """Hold a flight of ``x29`` against the linear response to the stick that flew. The stick must move the aircraft."""
    stick = truth.stick
    linear = respond(x29, stick)[1][:3]
    largest = float(np.abs(stick).max())
    limited = (truth.command_limited | truth.rate_limited | truth.stopped).any(axis=0)

    def of_q(change: Change, size: float = 1.0) -> float:
        duration = float(truth.time[-1])
        _, flown = fly_closed_loop(change(x29), size * stick, duration)
        return _share(_motion(flown)[1], size * linear[1]) if flown.outcome is FlightOutcome.COMPLETED else float("nan")

    flown = _motion(truth)
    return LinearCheck(
        truth.time,
        flown,
        linear,
        {name: _share(one, other) for name, one, other in zip(OUTPUTS, flown, linear, strict=True)},
        {
            "the break-out": of_q(lambda x: _straight(_unlimited(x))),
            "the gearing": of_q(lambda x: _without_break_out(_unlimited(x))),
            "the limits": of_q(lambda x: _straight(_without_break_out(x))),
            "none of these": of_q(lambda x: _straight(_without_break_out(_unlimited(x)))),
        },
        largest,
        STICKS,
        {
            "as flown": tuple(of_q(lambda x: x, size / largest) for size in STICKS),
            "no break-out": tuple(of_q(_without_break_out, size / largest) for size in STICKS),
            "limits alone": tuple(of_q(lambda x: _straight(_without_break_out(x)), size / largest) for size in STICKS),
        },
        float(limited.mean()),
    )


def linear_content(check: LinearCheck) -> dict[str, object]:
    """The check for ``comparison.json``; a size at which the aircraft departs is left out."""
    curves = {
        label: [{"stick": size, "misfit": value} for size, value in zip(check.sticks, values, strict=True) if np.isfinite(value)]
        for label, values in check.curves.items()
    }
    return {"misfit": dict(check.misfit), "q_misfit_of": dict(check.apart), "stick": check.stick, "by_stick": curves, "limited": check.limited}


def linear_sentence(check: LinearCheck) -> str:
    """What the flown loop differs by, what from, and what is left at a small stick."""
    told = ", ".join(f"{name} {_percent(value)}" for name, value in check.misfit.items())
    apart = ", ".join(f"{label} {_percent(value)}" for label, value in check.apart.items())
    small, free = check.curves["as flown"][0], check.curves["no break-out"][0]
    verdict = "two writings of one loop" if check.same else "NOT the same loop"
    return (
        f"flown against the linear loop's forced response (python-control) to the same stick, root mean square over the response's: {told}; "
        f"with one departure from linearity at a time q differs by: {apart} ({verdict}); a limit is met in {100.0 * check.limited:.2g} % of "
        f"the frames; at a stick of {check.sticks[0]:g} in at most q differs by {_percent(small)}, without the break-out by {_percent(free)}"
    )


def _motion(truth: ClosedLoopTruth) -> np.ndarray:
    return np.stack([truth.alpha, truth.q, truth.nz - 1.0])


def _share(flown: np.ndarray, linear: np.ndarray) -> float:
    return float(np.linalg.norm(flown - linear) / np.linalg.norm(linear))


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "unknown (it departs)"
    return f"{100.0 * share:.0e} %" if share < ROUNDING else f"{100.0 * share:.2g} %" if share < 0.99 else f"{100.0 * share:.0f} %"


def _without_break_out(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, dead_band=0.0))


def _straight(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, curvature=0.0))


def _unlimited(x29: X29) -> X29:
    canard, flaperon, strake = (replace(surface, rate=NO_LIMIT, lower=-NO_LIMIT, upper=NO_LIMIT) for surface in x29.surfaces)
    return replace(x29, surfaces=(canard, flaperon, strake))
