"""Phase margins of flight and simulation over values that the paper leaves open.

The varied values are our choices [own]; NASA TM-101722 does not publish them. The loop of the
simulation is airframe S, that of the flight is F, with the same control law. At each point, both
aircraft are matched to the published low-order equivalents (`loop.py`). The spread of the margins
is the uncertainty that the published numbers leave. Margins are computed by python-control.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scenarios.x29.declaration import MarginPlan
from scenarios.x29.loop import (
    Beginning,
    Matched,
    PrintedTarget,
    beginning,
    beginning_at,
    match,
    targets,
)
from sim.closed_loop.airframe import X29, Sensor, load_x29
from sim.closed_loop.linear import Margins, margins

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
    """Share of the loops in which the flight has the larger margin, and its main cause."""
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
