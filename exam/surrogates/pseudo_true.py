"""Pseudo-true values: the limits of a model's estimates on flights of one kind without sensor
noise, with all small causes that the model lacks; and the joint fit of very many records.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exam.surrogates.fitting import declared_model
from exam.surrogates.flights.drawing import Drawn
from exam.surrogates.flights.flying import fly_draws
from ident.statistics.minimise import cost_rounding, local_model
from ident.whole_record.gauss_newton import evaluate
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from scenarios.preparation.measured_inputs import about_trim, with_flow
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, Regularity
from sim.declaration.model import System
from sim.declaration.proposal import RangedCurve, Traceable
from sim.effects.library import find_effect
from sim.errors import ModelError
from sim.record import Record

# ---- Output error over very many records together

PASSES = 20  # most simulations of all records
REWEIGHED = 30  # most updates of the noise variances for a step
SETTLED = 0.1  # largest step of a converged fit, in white sigmas
SHARE = 0.03  # largest step of a converged fit, in standard errors
ROUNDED = 1e-10  # rounding, relative to a value
CALM = 1e-9  # largest relative change of a variance that has converged
# Predicted gain of log likelihood of a refused step, below which the fit ends: two white sigmas.
KINK = 2.0
LITTLE = 1e-2  # damping that hardly shortens a step


@dataclass(frozen=True, eq=False)
class Point:
    """Values of the unknowns: ``shared (n,)`` and, for each record, ``own (R, k)``; and the
    trajectories ``states (nx, K + 1)`` from which each record is simulated.
    """

    shared: np.ndarray
    own: np.ndarray
    states: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums of a quadratic cost about a point, by record and output: ``J'J (R, m, c, c)``, ``J'r (R,
    m, c)``, ``r'r (R, m)``, number of samples ``(R, m)``.

    The c unknowns are the shared ones, then the record's own. ``smallest (m,)`` is the variance of
    a residual that is exact to rounding.
    """

    information: np.ndarray
    slope: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    smallest: np.ndarray

    @property
    def weight(self) -> np.ndarray:
        """Return the inverse variance of each output, ``(m,)``: samples over their squares."""
        return self.counts.sum(axis=0) / self.floored(self.squares.sum(axis=0))

    @property
    def cost(self) -> float:
        return -0.5 * float(self.counts.sum(axis=0) @ np.log(self.weight))

    def floored(self, squares: np.ndarray) -> np.ndarray:
        """Return the sums of squares, not below rounding, ``(m,)``."""
        return np.maximum(squares, self.smallest * self.counts.sum(axis=0))

    def moved(self, step: np.ndarray) -> Sums:
        """Return the sums about the point that lies ``step (R, c)`` further, for a quadratic
        cost.
        """
        pressed = np.einsum("rmij,rj->rmi", self.information, step)
        squares = self.squares - np.einsum("rmi,ri->rm", 2.0 * self.slope - pressed, step)
        return Sums(
            self.information,
            self.slope - pressed,
            np.maximum(squares, 0.0),
            self.counts,
            self.smallest,
        )


@dataclass(frozen=True, eq=False)
class Joint:
    """A finished fit: ``names`` of the shared unknowns, the point, their ``covariance (n, n)`` by
    `sandwich`, and whether it converged.
    """

    names: tuple[str, ...]
    point: Point
    covariance: np.ndarray
    settled: bool


def fit_together(
    draws: Sequence[Sequence[Record]],
    system: System,
    start: Point | None = None,
    *,
    step: float = 0.01,
) -> Joint:
    """Fit the shared parameters of a System to all records of all draws; biases and initial states
    are fitted for each record.

    ``start`` : None begins at the System's values and each record's first samples; ``step`` is the
    integration step, s.

    Raises
    ------
    ModelError : no finite cost at the start. numpy.linalg.LinAlgError : what a record has for
    itself is not determined.
    """
    settings = FitSettings(max_step=step)
    layout = lay_out(draws[0], system, settings)
    if start is None:
        start = _at_rest([lay_out(draw, system, settings) for draw in draws])
    low, high = layout.low[: len(layout.shared)], layout.high[: len(layout.shared)]
    start = Point(np.clip(start.shared, low, high), start.own, start.states)
    found = _summed(draws, system, settings, start)
    if found is None:
        raise ModelError(
            "the declared model has no finite cost on these records",
            where=draws[0][0].name,
            remedy="check the declared levels",
        )
    (point, sums), damping, n = found, 0.0, len(layout.shared)
    of_draw = np.repeat(np.arange(len(draws)), [len(draw) for draw in draws])
    for _ in range(PASSES):
        move, sigma = minimised(sums, point.shared, low, high, damping)
        moved = Point(point.shared + move[0, :n], point.own + move[:, n:], point.states)
        after = sums.moved(move)
        covariance = sandwich(after, n, of_draw)
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        least = np.maximum(
            np.maximum(SETTLED * sigma, SHARE * errors), ROUNDED * np.abs(point.shared)
        )
        # A negligible step is taken without another simulation.
        if damping < LITTLE and np.all(np.abs(move[0, :n]) < least):
            return Joint(layout.shared, moved, covariance, True)
        trial = _summed(draws, system, settings, moved)
        if trial is not None and trial[1].cost <= sums.cost + cost_rounding(
            float(sums.counts.sum())
        ):
            (point, sums), damping = trial, damping / 10.0 if damping > 1e-5 else 0.0
        elif sums.cost - sums.moved(minimised(sums, point.shared, low, high, 0.0)[0]).cost < KINK:
            # Limits and gaps leave slopes that jump: what the whole step promises is not there.
            return Joint(layout.shared, point, sandwich(sums, n, of_draw), True)
        else:
            damping = max(10.0 * damping, 1e-4)
    return Joint(layout.shared, point, sandwich(sums, n, of_draw), False)


def minimised(
    sums: Sums, shared: np.ndarray, low: np.ndarray, high: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the step ``(R, c)`` to the least cost of the quadratic problem within the bounds of
    the shared unknowns, and their white sigmas ``(n,)``.
    """
    n, weight = len(shared), sums.weight
    for _ in range(REWEIGHED):
        information, gradient, back, rest = eliminated(sums, weight, n, damping)
        model = local_model(information, gradient, shared, low, high)
        step = np.clip(shared + model.scale * model.step(damping), low, high) - shared
        move = np.concatenate([np.broadcast_to(step, (len(rest), n)), rest - back @ step], axis=1)
        before, weight = weight, sums.moved(move).weight
        if np.all(np.abs(weight - before) < CALM * before):
            break
    sigma, at = np.zeros(n), np.flatnonzero(model.movable)
    sigma[at] = model.scale[at] * np.sqrt(
        np.maximum(np.diag(np.linalg.inv(model.information[np.ix_(at, at)])), 0.0)
    )
    return move, sigma


def eliminated(
    sums: Sums, weight: np.ndarray, n: int, damping: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return information ``(n, n)`` and gradient ``(n,)`` of the shared unknowns, with each
    record's own unknowns at their best.

    The own unknowns of a record follow from ``own step = rest (R, k) - back (R, k, n) @ shared
    step``.
    """
    W, g = (
        np.einsum("m,rmij->rij", weight, sums.information),
        np.einsum("m,rmi->ri", weight, sums.slope),
    )
    mine = W[:, n:, n:].copy()
    k = np.arange(mine.shape[1])
    mine[:, k, k] = np.where(mine[:, k, k] > 0, (1.0 + damping) * mine[:, k, k], 1.0)
    solved = np.linalg.solve(mine, np.concatenate([W[:, n:, :n], g[:, n:, None]], axis=2))
    back, rest = solved[:, :, :n], solved[:, :, n]
    information = (W[:, :n, :n] - np.swapaxes(W[:, n:, :n], 1, 2) @ back).sum(axis=0)
    gradient = (g[:, :n] - np.einsum("rki,rk->ri", W[:, n:, :n], rest)).sum(axis=0)
    return 0.5 * (information + information.T), gradient, back, rest


def sandwich(sums: Sums, n: int, draw: np.ndarray) -> np.ndarray:
    """Return the covariance ``(n, n)`` of the shared unknowns at the optimum, from the scatter of
    scores between draws.

    Variances of the outputs are estimates, too, and their changes by a draw are included (White,
    Econometrica 50, 1982, for the cost with own unknowns and variances at their best). ``draw
    (R,)`` has the number of each record's draw, from 0.
    """
    weight, counts = sums.weight, sums.counts.sum(axis=0)
    information, _, back, _ = eliminated(sums, weight, n)
    slopes = sums.slope[:, :, :n] - np.einsum("rmk,rkn->rmn", sums.slope[:, :, n:], back)
    last = int(draw.max()) + 1
    by_draw = np.array([slopes[draw == d].sum(axis=0) for d in range(last)])
    total = by_draw.sum(axis=0)
    excess = (
        np.array(
            [
                (sums.squares[draw == d] - sums.counts[draw == d] / weight).sum(axis=0)
                for d in range(last)
            ]
        )
        / counts
    )
    scores = np.einsum("m,dmn->dn", weight, by_draw) - np.einsum(
        "mn,dm->dn", total, weight**2 * excess
    )
    scores = scores - scores.mean(axis=0)
    curvature = information - 2.0 * np.einsum("m,mi,mj->ij", weight**2 / counts, total, total)
    at = np.flatnonzero(np.diag(information) > 0)
    covariance = np.zeros((n, n))
    inverse = np.linalg.inv(curvature[np.ix_(at, at)])
    covariance[np.ix_(at, at)] = (
        inverse @ (scores[:, at].T @ scores[:, at]) @ inverse * last / max(1, last - 1)
    )
    return covariance


def _summed(
    draws: Sequence[Sequence[Record]], system: System, settings: FitSettings, point: Point
) -> tuple[Point, Sums] | None:
    """Simulate and sum draw by draw, so that sensitivities of one draw are in memory at a time;
    return None if a cost is not finite.
    """
    information, slope, squares, counts, states, smallest, first = [], [], [], [], [], [], 0
    for records in draws:
        layout, last = lay_out(records, system, settings), first + len(records)
        theta = np.concatenate([point.shared, point.own[first:last].ravel()])
        fit = evaluate(FitProblem(layout), theta, list(point.states[first:last]))
        if fit is None:
            return None
        for problem, line in zip(layout.problems, fit.linearisations, strict=True):
            residual, J = (
                np.where(problem.valid, problem.z - line.y, 0.0),
                np.where(problem.valid[:, :, None], line.jacobian, 0.0),
            )
            turned = np.swapaxes(J, 1, 2)
            information.append(turned @ J)
            slope.append((turned @ residual[:, :, None])[:, :, 0])
            squares.append((residual**2).sum(axis=1))
            counts.append(problem.valid.sum(axis=1))
            states.append(line.states)
        smallest.append(layout.smallest)
        first = last
    sums = Sums(
        np.array(information),
        np.array(slope),
        np.array(squares),
        np.array(counts),
        np.max(smallest, axis=0),
    )
    return Point(point.shared, point.own, tuple(states)), sums


def _at_rest(layouts: Sequence[FitLayout]) -> Point:
    """Return a start for records that begin at rest: the first reading of a channel is its bias,
    and its state begins at zero.
    """
    own, states = [], []
    for layout in layouts:
        for problem, guess in zip(layout.problems, layout.guesses(layout.start), strict=True):
            shown = zip(layout.system.output_names, problem.z, problem.valid, strict=True)
            biases = {name: float(z[valid][0]) for name, z, valid in shown if valid.any()}
            own.append(
                [
                    *(biases.get(name.removeprefix("bias_"), 0.0) for name in layout.local),
                    *np.zeros(len(layout.free_initial)),
                ]
            )
            states.append(
                guess - np.array([[biases.get(name, 0.0)] for name in layout.system.state_names])
            )
    n = len(layouts[0].shared)
    return Point(layouts[0].start[:n], np.array(own), tuple(states))


# ---- Pseudo-true values

SPEED = ("airspeed", "dynamic_pressure")
FEW = 2  # number of draws in the first fit
FOLD = 10  # ratio of the numbers of draws of two successive fits

# Of random forcing, isolated samples and what belongs to one record, nothing carries over to other
# flights.
_OF_ONE_RECORD = (Regularity.PROCESS_NOISE, Regularity.OUTLIER)


@dataclass(frozen=True)
class PseudoTrue:
    """Values by parameter name (SI), with standard errors for the number of draws, and the nominal
    derivatives.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    nominal: Mapping[str, float]

    def bias(self, name: str) -> float:
        """Pseudo-true minus nominal value, relative to the nominal value."""
        return (self.values[name] - self.nominal[name]) / abs(self.nominal[name])


def pseudo_true(
    drawn: Drawn,
    effects: Mapping[str, Mapping[str, float]],
    draws: int,
    rng: np.random.Generator,
    count: int | None = None,
    starts: Mapping[str, float] | None = None,
) -> PseudoTrue:
    """Fit the declared model with effects to many flights of the same plan together.

    Each draw has its own gusts, thrust, masses, trims and noise of the recorded surfaces, and no
    sensor noise. Parameters are shared by all records of all draws; biases and initial states are
    fitted for each record. Standard errors follow from the scatter of the scores between draws.

    Parameters
    ----------
    effects : what the model has beyond the derivatives, by name with local values to start from
    (empty for the hidden ones, which start
        from the truth). Effects that random forcing, isolated samples or one record make are left
        out.
    draws : at least two. count : how many of the plan's records are fitted, all when None.
    starts : derivatives to start from, nominal where it has none: the nearer, the sooner done.

    Raises
    ------
    ModelError : no finite cost, or a fit that does not settle. numpy.linalg.LinAlgError : an
    unknown that nothing determines.
    """
    added = [
        item
        for item in (_effect(drawn, name, values) for name, values in effects.items())
        if item is not None
    ]
    nominal = {name: drawn.declared.parameters[name].value for name in drawn.starts}
    begun = {name: (starts or {}).get(name, value) for name, value in nominal.items()}
    model = declared_model(drawn.declared, begun, added)
    # Trims of the surfaces are taken off, and a speed that is recorded is used, as in a diagnosis.
    measured = drawn.axis.measured
    flown = fly_draws(drawn, rng.spawn(max(2, draws)), (*measured, *SPEED), count=count)
    wider = [with_flow(model, [about_trim(record)[0] for record in records]) for records in flown]
    system = compile_model(wider[0][0], measured)
    records = [[record.only(measured) for record in carrying] for _, carrying in wider]
    many = FEW
    joint = fit_together(records[:many], system)
    while many < len(records):
        many = min(FOLD * many, len(records))
        joint = fit_together(records[:many], system, _carried(joint.point, many, len(records[0])))
    if not joint.settled:
        raise ModelError(
            "the fit to all draws does not settle",
            where=", ".join(effects) or "no effect",
            remedy="start from other values",
        )
    std = np.sqrt(np.diag(joint.covariance))
    values = dict(zip(joint.names, joint.point.shared.tolist(), strict=True))
    return PseudoTrue(values, dict(zip(joint.names, std.tolist(), strict=True)), nominal)


def has_limit(drawn: Drawn, claimed: Iterable[str]) -> bool:
    """Return whether the claimed effects can be fitted to many flights.

    They cannot if random forcing, or an effect that belongs to one record, was fitted as well;
    without it the derivatives have other limits. Isolated samples are only masked.
    """
    for name in claimed:
        effect = find_effect(name, drawn.declared.equations)
        if effect.regularity is Regularity.OUTLIER:
            continue
        if effect.regularity is Regularity.PROCESS_NOISE or _effect(drawn, name, {}) is None:
            return False
    return True


def _carried(point: Point, draws: int, records: int) -> Point:
    """Return a start for many draws: each has the biases, initial states and trajectories of the
    first one's ``records``, whose maneuvers they share.
    """
    return Point(
        point.shared, np.tile(point.own[:records], (draws, 1)), point.states[:records] * draws
    )


def _effect(
    drawn: Drawn, name: str, values: Mapping[str, float]
) -> tuple[Effect, Mapping[str, float]] | None:
    for dominant in drawn.hidden:
        if dominant.name == name:
            return (
                (dominant.effect, dominant.values)
                if len(dominant.records) == len(drawn.maneuvers) and name != "speed-variation"
                else None
            )
    effect = find_effect(name, drawn.declared.equations)
    if effect.regularity in _OF_ONE_RECORD or (
        isinstance(effect, Traceable) and effect.traits.per_record
    ):
        return None
    # Curves are declared over the range that a search saw; elsewhere their shapes are others, and
    # start from none.
    return effect, (dict(effect.absent) if isinstance(effect, RangedCurve) else values)
