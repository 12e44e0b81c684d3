"""The closed loop compared with its linear form, and airframes matched to printed equivalents.

The nonlinear loop has a break-out, a progressive gearing, and surface limits; the linear loop has
a constant gain instead.

Matched are L_alpha, M_alpha, the pitching moment of the surfaces (one factor) and the stick's lag.
Not matched are L_delta, which depends on the model's order, and the delay, which depends on the
stick's path outside the loop and affects no margin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from scenarios.x29.declaration import NO_LIMIT, OUTPUTS, printed_column
from sim.closed_loop.airframe import X29
from sim.closed_loop.equations import sampled_loop
from sim.closed_loop.linear import EquivalentSystem, Margins, fit_equivalent, loop_margins, respond
from sim.closed_loop.nonlinear import ClosedLoopTruth, FlightOutcome, fly_closed_loop

# ---- The nonlinear loop against the linear one

# in, the largest deflection of each scaled stick; the last asks for some 6 g
STICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
RESPONSE_TOLERANCE = 1e-9  # relative error between two forms of the same loop
Change = Callable[[X29], X29]


@dataclass(frozen=True, eq=False)
class LinearCheck:
    """Relative misfits between nonlinear and linear response, as ratios of root mean squares.

    Attributes
    ----------
    time : ``(F,)`` s, frames of the control computer.
    simulated, linear : ``(3, F)``: alpha (rad), q (rad/s) and incremental nz (g), without noise.
    misfit : by output.
    apart : misfit of q with a single nonlinearity, by nonlinearity, and with none.
    stick : largest deflection, in.
    sticks : largest deflections of the same input at other amplitudes, in.
    curves : misfit of q at ``sticks``, with all and with some nonlinearities; NaN if the aircraft
        departs.
    limited : share of frames with an active command, rate or travel limit.
    """

    time: np.ndarray
    simulated: np.ndarray
    linear: np.ndarray
    misfit: Mapping[str, float]
    apart: Mapping[str, float]
    stick: float
    sticks: tuple[float, ...]
    curves: Mapping[str, tuple[float, ...]]
    limited: float

    @property
    def same(self) -> bool:
        """Whether only rounding remains without the nonlinearities."""
        return self.apart["none of these"] < RESPONSE_TOLERANCE


def linear_check(x29: X29, truth: ClosedLoopTruth) -> LinearCheck:
    """Compare a flight of ``x29`` with the linear response to the same stick.

    The stick must move the aircraft.
    """
    stick = truth.stick
    linear = respond(x29, stick)[1][:3]
    largest = float(np.abs(stick).max())
    limited = (truth.command_limited | truth.rate_limited | truth.stopped).any(axis=0)

    def q_misfit(change: Change, size: float = 1.0) -> float:
        """Return the misfit of q for a changed aircraft and a stick scaled by ``size``."""
        _, simulated = fly_closed_loop(change(x29), size * stick, float(truth.time[-1]))
        if simulated.outcome is not FlightOutcome.COMPLETED:
            return float("nan")
        return _relative_misfit(_motion(simulated)[1], size * linear[1])

    simulated = _motion(truth)
    return LinearCheck(
        truth.time,
        simulated,
        linear,
        {
            name: _relative_misfit(flown, expected)
            for name, flown, expected in zip(OUTPUTS, simulated, linear, strict=True)
        },
        {
            "the break-out": q_misfit(lambda x: _straight(_unlimited(x))),
            "the gearing": q_misfit(lambda x: _without_break_out(_unlimited(x))),
            "the limits": q_misfit(lambda x: _straight(_without_break_out(x))),
            "none of these": q_misfit(lambda x: _straight(_without_break_out(_unlimited(x)))),
        },
        largest,
        STICKS,
        {
            "as flown": tuple(q_misfit(lambda x: x, size / largest) for size in STICKS),
            "no break-out": tuple(q_misfit(_without_break_out, size / largest) for size in STICKS),
            "limits alone": tuple(
                q_misfit(lambda x: _straight(_without_break_out(x)), size / largest)
                for size in STICKS
            ),
        },
        float(limited.mean()),
    )


def linear_content(check: LinearCheck) -> dict[str, object]:
    """Return the check for ``comparison.json``, without sizes at which the aircraft departs."""
    curves = {
        label: [
            {"stick": size, "misfit": value}
            for size, value in zip(check.sticks, values, strict=True)
            if np.isfinite(value)
        ]
        for label, values in check.curves.items()
    }
    return {
        "misfit": dict(check.misfit),
        "q_misfit_of": dict(check.apart),
        "stick": check.stick,
        "by_stick": curves,
        "limited": check.limited,
    }


def linear_sentence(check: LinearCheck) -> str:
    """Return the sentence on the differences of the nonlinear loop, their causes, and what remains
    at a small stick.
    """
    text = ", ".join(f"{name} {_percent(value)}" for name, value in check.misfit.items())
    apart = ", ".join(f"{label} {_percent(value)}" for label, value in check.apart.items())
    small, free = check.curves["as flown"][0], check.curves["no break-out"][0]
    verdict = "two writings of one loop" if check.same else "NOT the same loop"
    return (
        "flown against the linear loop's forced response (python-control) to the same stick, root "
        f"mean square over the response's: {text}; "
        f"with one departure from linearity at a time q differs by: {apart} ({verdict}); a limit "
        f"is met in {100.0 * check.limited:.2g} % of "
        f"the frames; at a stick of {check.sticks[0]:g} in at most q differs by {_percent(small)}, "
        f"without the break-out by {_percent(free)}"
    )


def _motion(truth: ClosedLoopTruth) -> np.ndarray:
    return np.stack([truth.alpha, truth.q, truth.nz - 1.0])


def _relative_misfit(simulated: np.ndarray, linear: np.ndarray) -> float:
    return float(np.linalg.norm(simulated - linear) / np.linalg.norm(linear))


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "unknown (it departs)"
    form = ".0e" if share < RESPONSE_TOLERANCE else ".2g" if share < 0.99 else ".0f"
    return f"{100.0 * share:{form}} %"


def _without_break_out(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, dead_band=0.0))


def _straight(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, curvature=0.0))


def _unlimited(x29: X29) -> X29:
    canard, flaperon, strake = (
        replace(surface, rate=NO_LIMIT, lower=-NO_LIMIT, upper=NO_LIMIT) for surface in x29.surfaces
    )
    return replace(x29, surfaces=(canard, flaperon, strake))


# ---- An airframe fitted so that its loop has the low-order equivalent that the paper prints

MATCHED = ("L_alpha", "M_alpha", "M_q", "M_delta", "inv_tau")
# sum of squared deviations that five values exceed once in twenty (chi-square)
CHI_SQUARE_95 = 11.07
FLIGHTS = ("flight", "time_shift", "convergence")  # the paper's three estimates of one flight
MATCHED_OMEGA = np.geomspace(0.35, 14.0, 40)  # rad/s, as ``equivalent_system``
MARGIN_OMEGA = np.geomspace(0.5, 120.0, 240)  # rad/s, around every crossing
# Bounds and sizes of the unknowns of ``changed``: 1/s, 1/s2, 1, s
_LOW, _HIGH = np.array([-10.0, -60.0, 0.2, 1e-3]), np.array([-0.1, 120.0, 4.0, 0.2])
_SIZE = np.array([0.1, 3.0, 0.1, 0.01])
_LEAST_GAIN = 0.01  # smallest gain of the sum of squares that continues the search
_MOST_STEPS = 12


@dataclass(frozen=True)
class PrintedTarget:
    """A printed value and how far a loop may be from it, one sigma."""

    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Matched:
    """A matched aircraft: computing delay (s), matched values ``(4,)``, equivalent, cost, margins.

    The cost is the sum of squared deviations from the targets.
    """

    x29: X29
    delay: float
    parameters: np.ndarray
    equivalent: EquivalentSystem
    misfit: float
    margins: Margins
    stable: bool

    @property
    def plausible(self) -> bool:
        """Whether it is stable and has the paper's equivalent within the scatter of the paper's
        estimates.
        """
        return self.stable and self.misfit <= CHI_SQUARE_95


@dataclass(frozen=True, eq=False)
class Beginning:
    """Start of a search: unknowns ``(4,)``, Jacobian of the deviations ``(5, 4)``, equivalent."""

    parameters: np.ndarray
    slopes: np.ndarray
    equivalent: EquivalentSystem


def targets(column: str) -> dict[str, PrintedTarget]:
    """Return a printed column with sigmas: the printed ones, or the relative scatter of the paper's
    three estimates of its flight where that is larger.
    """
    flights = [printed_column(name) for name in FLIGHTS]
    printed, out = printed_column(column), {}
    for name in MATCHED:
        values = np.array([flight[name].value for flight in flights])
        scatter = float(values.std(ddof=1) / abs(values.mean()))
        cell = printed[name]
        out[name] = PrintedTarget(cell.value, max(scatter * abs(cell.value), cell.std or 0.0))
    return out


def beginning(x29: X29, wanted: Mapping[str, PrintedTarget]) -> Beginning:
    """Return the search's start for an aircraft as declared: slopes by small steps."""
    parameters = np.array([x29.airframe.L_alpha, x29.airframe.M_alpha, 1.0, 1.0 / x29.stick.lag])
    near = equivalent_of(x29, x29.frame)
    return Beginning(parameters, _slopes(x29, x29.frame, wanted, parameters, near), near)


def beginning_at(matched: Matched, wanted: Mapping[str, PrintedTarget], x29: X29) -> Beginning:
    """Return the start of a search for a loop similar to a matched one."""
    return Beginning(
        matched.parameters,
        _slopes(x29, matched.delay, wanted, matched.parameters, matched.equivalent),
        matched.equivalent,
    )


def match(x29: X29, delay: float, wanted: Mapping[str, PrintedTarget], begin: Beginning) -> Matched:
    """Fit an aircraft's loop to an equivalent by Gauss-Newton steps.

    Broyden's method updates the Jacobian; it is recomputed if a step fails.
    """
    from scipy.optimize import lsq_linear

    p, J = begin.parameters, begin.slopes
    near = equivalent_of(changed(x29, p), delay, begin.equivalent)
    r, is_fresh = _deviations(near, wanted), False
    for _ in range(_MOST_STEPS):
        step = _SIZE * lsq_linear(J * _SIZE, -r, ((_LOW - p) / _SIZE, (_HIGH - p) / _SIZE)).x
        for share in (1.0, 0.3):
            s = share * step
            there = equivalent_of(changed(x29, p + s), delay, near)
            moved = _deviations(there, wanted)
            J = J + np.outer(moved - r - J @ s, s / _SIZE**2) / max(
                float(np.sum((s / _SIZE) ** 2)), 1e-12
            )
            if better := bool(moved @ moved < r @ r):
                break
        gained = float(r @ r - moved @ moved)
        if better:
            p, r, near, is_fresh = p + s, moved, there, is_fresh and gained < _LEAST_GAIN
        if gained < _LEAST_GAIN:
            if is_fresh:
                break
            J, is_fresh = _slopes(x29, delay, wanted, p, near), True
    matched = changed(x29, p)
    loop = sampled_loop(matched, delay).open_loop
    stable = bool(np.abs(np.linalg.eigvals(loop.A - loop.B @ loop.C)).max() < 1.0)
    return Matched(matched, delay, p, near, float(r @ r), loop_margins(loop, MARGIN_OMEGA), stable)


def _slopes(
    x29: X29,
    delay: float,
    wanted: Mapping[str, PrintedTarget],
    p: np.ndarray,
    near: EquivalentSystem,
) -> np.ndarray:
    """Return the slopes of the deviations by the parameters, ``(5, 4)``, by small steps."""
    first = _deviations(near, wanted)
    columns = [
        (_deviations(equivalent_of(changed(x29, p + step), delay, near), wanted) - first)
        / step.sum()
        for step in 0.05 * np.diag(_SIZE)
    ]
    return np.array(columns).T


def has_equivalent(x29: X29, wanted: Mapping[str, PrintedTarget]) -> bool:
    """Return whether the declared aircraft has the wanted equivalent within its scatter."""
    deviations = _deviations(equivalent_of(x29, x29.law.delay_frames * x29.frame), wanted)
    return float(deviations @ deviations) <= CHI_SQUARE_95


def changed(x29: X29, p: np.ndarray) -> X29:
    """Return the aircraft with parameters p = (L_alpha, M_alpha, factor on the surfaces' moments,
    time constant of the stick's lag).
    """
    a, (L_alpha, M_alpha, factor, time) = x29.airframe, p.tolist()
    canard, flaperon, strake = (factor * moment for moment in a.M_surface)
    airframe = replace(a, L_alpha=L_alpha, M_alpha=M_alpha, M_surface=(canard, flaperon, strake))
    return replace(x29, airframe=airframe, stick=replace(x29.stick, lag=1.0 / time))


def equivalent_of(x29: X29, delay: float, near: EquivalentSystem | None = None) -> EquivalentSystem:
    """Return the low-order equivalent of a loop with a computing delay of ``delay`` s.

    The search starts from the equivalent of a similar loop.
    """
    response = sampled_loop(x29, delay).response(MATCHED_OMEGA)
    return fit_equivalent(
        MATCHED_OMEGA, response, x29.airframe.airspeed, x29.airframe.gravity, near=near
    )


def _deviations(equivalent: EquivalentSystem, wanted: Mapping[str, PrintedTarget]) -> np.ndarray:
    return np.array(
        [(getattr(equivalent, name) - target.value) / target.std for name, target in wanted.items()]
    )
