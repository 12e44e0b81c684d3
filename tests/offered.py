"""What the library offers to each kind of equations, and the few instances that stand for the rest
where laws are dear.
"""

from __future__ import annotations

from sim.declaration.effect import Effect, Station
from sim.declaration.model import Equations
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.dynamics.varies import MissingTerm
from sim.effects.library import catch_all_terms_for, effects_for, library
from sim.vehicles.aircraft import aircraft_model
from sim.vehicles.other_vehicles import Ballistic, Multirotor
from sim.vehicles.uncoupled import Lateral, Loes, Longitudinal, ShortPeriod
from tests.airliner import AIRLINER

# Every instance on these is held to every law; on the whole axes those of ``representatives``.
VEHICLES: tuple[Equations, ...] = (ShortPeriod(), Loes(), Ballistic())
WHOLE_AXES: tuple[Equations, ...] = (Lateral(), Longitudinal(), Multirotor())
AIRCRAFT = aircraft_model(AIRLINER).equations
ALL_VEHICLES = (*VEHICLES, *WHOLE_AXES)


VARYING = "varies"  # of this stem there are dozens on each vehicle, which differ in names alone


def held_to_all_laws(vehicle: Equations) -> list[Effect]:
    """All effects that are offered to a vehicle, of the parameters that vary one over a state and
    one over an input.
    """
    seen, found = set[tuple[str, bool]](), list[Effect]()
    for effect in effects_for(vehicle):
        key = (stem(effect), getattr(effect, "state", True))
        if stem(effect) != VARYING or key not in seen:
            found.append(effect)
        seen.add(key)
    return found


def stem(effect: Effect) -> str:
    """The name without its label."""
    return effect.name.partition(":")[0]


def representatives() -> list[tuple[Effect, str]]:
    """Effects on whole axes with the name of these: all of the library that nothing else can carry,
    and one instance of every stem.

    What acts on a port is different on each of the axes and has one instance on both; inputs and
    sensors are alike everywhere.
    """
    covered = {effect for vehicle in VEHICLES for effect in held_to_all_laws(vehicle)}
    files, seen, found = {*library()}, set[tuple[str, str]](), list[tuple[Effect, str]]()
    for vehicle in WHOLE_AXES:
        for effect in effects_for(vehicle):
            on_ports = effect.station in (Station.DYNAMICS, Station.DISTURBANCE)
            key = (stem(effect), vehicle.name if on_ports else "")
            if isinstance(effect, StructuralMode) or (
                key in seen and (effect in covered or effect not in files)
            ):
                continue
            covered.add(effect)
            seen.add(key)
            found.append((effect, vehicle.name))
    terms = [each for each in effects_for(AIRCRAFT) if isinstance(each, MissingTerm)]
    return found + [(each, AIRCRAFT.name) for each in (terms[0], terms[-1])]


def made() -> list[Effect]:
    """Every instance that is offered to a whole axis and that none of the ``VARIANTS`` is, each
    once.
    """
    files = {*library()}
    return list(
        dict.fromkeys(
            effect
            for vehicle in WHOLE_AXES
            for effect in held_to_all_laws(vehicle)
            if effect not in files
        )
    )


def guards_of_whole_axes() -> list[tuple[Effect, str]]:
    """Guards that only a whole axis can carry, with its name."""
    known = {guard for vehicle in VEHICLES for guard in catch_all_terms_for(vehicle)}
    return [
        (guard, vehicle.name)
        for vehicle in WHOLE_AXES
        for guard in catch_all_terms_for(vehicle)
        if guard not in known
    ]


def first_of_each_kind(offered: list[tuple[Effect, str]]) -> list[tuple[Effect, str]]:
    """Those of which none before is of the same class on the same equations."""
    kinds = [(type(effect), base) for effect, base in offered]
    return [each for i, each in enumerate(offered) if kinds[i] not in kinds[:i]]
