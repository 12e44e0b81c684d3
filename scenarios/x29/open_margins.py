"""Airframes matched to printed low-order equivalents, and phase margins of flight and simulation
over values that the paper leaves open.

Matched are L_alpha, M_alpha, the pitching moment of the surfaces (one factor) and the stick's lag.
Not matched are L_delta, which depends on the model's order, and the delay, which depends on the
stick's path outside the loop and affects no margin.

The varied values are our choices [own]; NASA TM-101722 does not publish them. The loop of the
simulation is airframe S, that of the flight is F, with the same control law. At each point, both
aircraft are matched. The spread of the margins is the uncertainty that the published numbers leave.
Margins are computed by python-control.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scenarios.x29.declaration import MarginPlan, printed_column
from sim.closed_loop.airframe import X29, Sensor, load_x29
from sim.closed_loop.equations import sampled_loop
from sim.closed_loop.linear import EquivalentSystem, Margins, fit_equivalent, loop_margins, margins

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


# ---- What the paper leaves open of the two loops


@dataclass(frozen=True)
class OpenValue:
    """An unpublished value: a factor (``ratio``, varied evenly in its logarithm) or a difference,
    from ``low`` to ``high``.

    ``between``: it differs between flight and simulation outside the airframe.
    """

    name: str
    label: str
    low: float
    high: float
    ratio: bool = True
    between: bool = False

    def at(self, place: float) -> float:
        """Return the value at a place from -1 (``low``) to 1 (``high``)."""
        if self.ratio:
            return math.exp(
                0.5 * ((1.0 + place) * math.log(self.high) + (1.0 - place) * math.log(self.low))
            )
        return 0.5 * ((1.0 + place) * self.high + (1.0 - place) * self.low)


# Ranges: servos and sensors 25 % (usual tolerance), delay half a frame (unsynchronised computers),
# pitch damping half to double (difference of wind tunnels and estimates).
OPEN = (
    OpenValue("surfaces", "surfaces' bandwidth, both", 0.8, 1.25),
    OpenValue("sensors", "sensors' bandwidth, both", 0.8, 1.25),
    OpenValue("computing", "computing delay, both, frames", 0.5, 1.5, ratio=False),
    OpenValue("damping_simulation", "pitch damping, simulation, times", 0.5, 2.0),
    OpenValue("damping_flight", "pitch damping, flight, times", 0.5, 2.0),
    OpenValue("lift_flight", "lift of the surfaces, flight, times", 0.5, 2.0),
    OpenValue(
        "surfaces_flight", "surfaces' bandwidth, flight over simulation", 0.8, 1.25, between=True
    ),
    OpenValue(
        "computing_flight",
        "computing delay, flight less simulation, frames",
        -0.5,
        0.5,
        ratio=False,
        between=True,
    ),
)


def hypercube(samples: int, seed: int) -> np.ndarray:
    """Return the places ``(samples, len(OPEN))`` from -1 to 1 of a Latin hypercube: each value's
    range is met evenly.
    """
    from scipy.stats import qmc

    return np.asarray(
        2.0 * qmc.LatinHypercube(len(OPEN), rng=np.random.default_rng(seed)).random(samples) - 1.0
    )


def values_at(places: np.ndarray) -> dict[str, float]:
    """Open values by name at places ``(len(OPEN),)``."""
    return {item.name: item.at(float(place)) for item, place in zip(OPEN, places, strict=True)}


def simulated_loop(x29: X29, values: Mapping[str, float]) -> tuple[X29, float]:
    """Return the simulation's aircraft at some open values, and its computing delay (s)."""
    airframe = replace(x29.airframe, M_q=values["damping_simulation"] * x29.airframe.M_q)
    return _systems(replace(x29, airframe=airframe), values["surfaces"], values["sensors"]), values[
        "computing"
    ] * x29.frame


def loop_at_values(x29: X29, values: Mapping[str, float]) -> tuple[X29, float]:
    """Return the flight's aircraft at some open values, and its computing delay (s)."""
    a = x29.airframe
    canard, flaperon, strake = (values["lift_flight"] * each for each in a.L_surface)
    airframe = replace(
        a, M_q=values["damping_flight"] * a.M_q, L_surface=(canard, flaperon, strake)
    )
    changed = _systems(
        replace(x29, airframe=airframe),
        values["surfaces"] * values["surfaces_flight"],
        values["sensors"],
    )
    return changed, (values["computing"] + values["computing_flight"]) * x29.frame


def _systems(x29: X29, surfaces: float, sensors: float) -> X29:
    """Return the aircraft with the speeds of servos, rams and sensors scaled."""
    canard, flaperon, strake = (
        replace(
            each,
            ram=surfaces * each.ram,
            servo_frequency=None
            if each.servo_frequency is None
            else surfaces * each.servo_frequency,
        )
        for each in x29.surfaces
    )
    gyro, accelerometer = (
        Sensor(sensors * each.frequency, each.damping) for each in (x29.gyro, x29.accelerometer)
    )
    return replace(x29, surfaces=(canard, flaperon, strake), gyro=gyro, accelerometer=accelerometer)


# ---- The phase margin of flight against that of simulation

AIRFRAMES = "airframes alone"  # the values of the airframes vary
EVERYTHING = "everything open"  # all unpublished values vary
ROWS_A_VALUE = 3  # points for each open value below which no straight line is drawn through them
LoopOf = Callable[[np.ndarray], tuple[X29, float]]


@dataclass(frozen=True, eq=False)
class MarginDesign:
    """One of two sets of variations; ``AIRFRAMES`` keeps surfaces and computing of the flight equal
    to the simulation's.

    Attributes
    ----------
    places : ``(N, open values)``, -1 to 1.
    simulation, flight : ``(N,)`` phase margins, deg.
    plausible : ``(N,)`` whether both aircraft are stable and have the paper's equivalents.
    """

    name: str
    places: np.ndarray
    simulation: np.ndarray
    flight: np.ndarray
    plausible: np.ndarray

    @property
    def difference(self) -> np.ndarray:
        """Flight less simulation of the plausible points, deg."""
        return np.asarray((self.flight - self.simulation)[self.plausible])

    @property
    def larger(self) -> int:
        """Plausible points in which the flight has the larger margin, as in the paper."""
        return int(np.count_nonzero(self.difference > 0.0))


@dataclass(frozen=True, eq=False)
class OpenMargins:
    """Range of the margins for all unpublished values.

    Attributes
    ----------
    effects : by open value, deg that the difference gains from the middle of its range to the high
        end; of a straight line through all plausible points, empty if there are too few.
    middle : deg at the middle of all ranges.
    explained : share of the variance.
    declared : flight less simulation of the airframes as they are declared, deg.
    """

    seed: int
    designs: tuple[MarginDesign, ...]
    declared: float
    middle: float
    effects: Mapping[str, float]
    explained: float

    def turning(self, name: str) -> float | None:
        """Return the value at which the declared sign would reverse, by linear regression; None
        outside its range.
        """
        effect = self.effects.get(name, 0.0)
        place = -self.declared / effect if effect else np.inf
        return (
            next(item for item in OPEN if item.name == name).at(place)
            if abs(place) <= 1.0
            else None
        )


def margins_of(airframes: Sequence[str], plan: MarginPlan | None) -> dict[str, Margins]:
    """Return the margins of airframes by name, and of the further one of a plan."""
    names = [*airframes, *([] if plan is None else [plan.beside])]
    return {name: margins(load_x29(name)) for name in dict.fromkeys(names) if name}


def planned_margins(plan: MarginPlan | None, found: Mapping[str, Margins]) -> OpenMargins | None:
    """Return the study of the first two airframes of ``found``, flight and simulation; None if
    there is no plan, no sample or no second airframe.
    """
    if plan is None or not plan.samples or len(found) < 2:
        return None
    flight, simulation = list(found)[:2]
    declared = found[flight].phase - found[simulation].phase
    return open_margins(load_x29(simulation), load_x29(flight), plan.samples, plan.seed, declared)


def open_margins(
    simulation: X29, flight: X29, samples: int, seed: int, declared: float
) -> OpenMargins:
    """Run the study for the two declared aircraft; ``declared`` is the difference of their own
    margins, deg.
    """
    places = hypercube(samples, seed)
    alone = np.array([0.0 if item.between else 1.0 for item in OPEN])
    wanted, goal = targets("simulation"), targets("flight")
    begin, start = beginning(simulation, wanted), beginning(flight, goal)
    simulated = [
        _matched(lambda place: simulated_loop(simulation, values_at(place)), place, wanted, begin)
        for place in places
    ]
    designs = []
    for name, rows in ((AIRFRAMES, alone * places), (EVERYTHING, places)):
        matched = [
            _matched(lambda place: loop_at_values(flight, values_at(place)), place, goal, start)
            for place in rows
        ]
        both = np.array(
            [a.plausible and b.plausible for a, b in zip(simulated, matched, strict=True)]
        )
        designs.append(MarginDesign(name, rows, _phases(simulated), _phases(matched), both))
    middle, effects, explained = _line(designs)
    return OpenMargins(seed, tuple(designs), declared, middle, effects, explained)


def margins_content(found: OpenMargins) -> dict[str, Any]:
    """Return the study for ``comparison.json``."""
    return {
        "seed": found.seed,
        "declared_deg": found.declared,
        "open": [{"name": item.name, "low": item.low, "high": item.high} for item in OPEN],
        "designs": [
            {
                "name": each.name,
                "points": len(each.places),
                "plausible": int(each.plausible.sum()),
                "larger_in_flight": each.larger,
                "places": each.places.tolist(),
                "simulation_deg": each.simulation.tolist(),
                "flight_deg": each.flight.tolist(),
                "accepted": each.plausible.tolist(),
            }
            for each in found.designs
        ],
        **(
            {
                "middle_deg": found.middle,
                "effects_deg": dict(found.effects),
                "explained": found.explained,
            }
            if found.effects
            else {}
        ),
    }


def margins_sentence(found: OpenMargins) -> str:
    """Return the share of loops in which the flight has the larger margin, and its main cause."""
    words = {
        AIRFRAMES: "the airframes alone differ",
        EVERYTHING: "surfaces and computing differ, too",
    }
    texts = [
        f"in {each.larger} of {int(each.plausible.sum())} where {words[each.name]} "
        f"({each.difference.min():+.1f} to {each.difference.max():+.1f} deg)"
        for each in found.designs
        if each.plausible.any()
    ]
    points = len(found.designs[0].places)
    out = (
        f"{points} points of a Latin hypercube over {len(OPEN)} values that the publication "
        "leaves open, both airframes fitted to its two columns at each: "
    )
    out += (
        f"the flight's phase margin is the larger {', '.join(texts)}"
        if texts
        else "no point has the published equivalents"
    )
    if found.effects:
        ordered = sorted(found.effects.items(), key=lambda item: -abs(item[1]))
        labels = {item.name: item.label for item in OPEN}
        listed = "; ".join(f"{labels[name]} {value:+.1f}" for name, value in ordered)
        out += (
            "; deg from the middle to the high end of each range (a straight line, "
            f"{100.0 * found.explained:.0f} % of the variance): {listed}"
        )
        alone = {
            item.name: found.turning(item.name) for item in OPEN if item.name.endswith("_flight")
        }
        turned = ", ".join(
            f"{labels[name]} {value:.2f}" for name, value in alone.items() if value is not None
        )
        if turned and found.declared < 0.0:
            out += f"; by itself would turn the sign of the declared airframes: {turned}"
    larger = sum(each.larger for each in found.designs)
    plausible = sum(int(each.plausible.sum()) for each in found.designs)
    if plausible:
        mixed = "the published numbers do not decide the sign"
        out += (
            ": "
            f"{mixed if 0 < larger < plausible else 'none of these has the published sign' if larger == 0 else 'all of these have the published sign'}"  # noqa: E501
        )
    return out


def _matched(
    loop_of: LoopOf, place: np.ndarray, wanted: Mapping[str, PrintedTarget], begin: Beginning
) -> Matched:
    """Return the aircraft fitted at a place; by way of the place half-way to it where the direct
    search ends badly.
    """
    x29, delay = loop_of(place)
    result = match(x29, delay, wanted, begin)
    if result.plausible:
        return result
    nearer, earlier = loop_of(0.5 * place)
    again = match(
        x29, delay, wanted, beginning_at(match(nearer, earlier, wanted, begin), wanted, nearer)
    )
    return again if (again.stable, -again.misfit) > (result.stable, -result.misfit) else result


def _phases(matched: list[Matched]) -> np.ndarray:
    return np.array([each.margins.phase for each in matched])


def _line(designs: list[MarginDesign]) -> tuple[float, dict[str, float], float]:
    """Return a straight line through the differences of all plausible points: at the middle, slopes
    by open value, share of the variance.
    """
    X = np.concatenate([each.places[each.plausible] for each in designs])
    y = np.concatenate([each.difference for each in designs])
    if len(y) < ROWS_A_VALUE * len(OPEN):
        return 0.0, {}, 0.0
    A = np.column_stack([np.ones(len(y)), X])
    slopes = np.linalg.lstsq(A, y, rcond=None)[0]
    left = float(np.var(y - A @ slopes) / np.var(y))
    return (
        float(slopes[0]),
        {item.name: float(value) for item, value in zip(OPEN, slopes[1:], strict=True)},
        1.0 - left,
    )
