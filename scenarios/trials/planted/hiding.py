"""Hidden terms by name: effects of the library, and the truth's own of `scenarios.trials.hidden`."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import replace

from scenarios.trials.planted.declaration import HiddenTerm, TraceFlight
from sim.closed_loop.airframe import X29
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Equations, Model, Noise
from sim.errors import DeclarationError

OWN = "own:"
TERMS = "scenarios.trials.hidden"  # the package of the terms that scenarios may hide
CLOSED_LOOP = "x29-"
BREAKOUT = "input-deadband"


def own_terms(package_name: str = TERMS) -> Mapping[str, Effect]:
    """The truth's own terms by name, from the modules of a package."""
    package = importlib.import_module(package_name)
    names = sorted(module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))
    modules = [importlib.import_module(name) for name in names]
    return {module.TERM.name: module.TERM for module in modules if hasattr(module, "TERM")}


def true_vehicle(flight: TraceFlight) -> Model:
    """The vehicle of a flight without what is hidden."""
    from scenarios.studies.estimating import vehicle_model

    if flight.own is not None:
        return flight.own.with_noise(Noise(flight.noise_std))
    return vehicle_model(flight.vehicle, flight.modes, Noise(flight.noise_std))


def hidden_units(name: str, vehicle: str | Model, where: str) -> Mapping[str, str]:
    """Local parameters of a hidden term with their units; ``vehicle`` is the name of a built-in one, or a user's own model.

    Raises
    ------
    DeclarationError : there is no such term for this vehicle.
    """
    if isinstance(vehicle, Model):
        return {item.name: item.unit for item in find_term(name, vehicle.equations, where).parameters}
    if vehicle.startswith(CLOSED_LOOP):
        if name != BREAKOUT:
            raise DeclarationError(f"{name!r} in a closed loop", where=f"{where}.name", remedy=f"use {BREAKOUT}, the break-out of its stick")
        return {"half_width": "in"}
    from sim.vehicles.factory import model_of
    from sim.vehicles.library import read_parameter_set

    effect = find_term(name, model_of(read_parameter_set(vehicle)).equations, where)
    return {item.name: item.unit for item in effect.parameters}


def find_term(name: str, equations: Equations, where: str, terms: Mapping[str, Effect] | None = None) -> Effect:
    """A hidden term that acts on these equations, the truth's own from ``terms`` (None: ``own_terms()``).

    Raises
    ------
    DeclarationError : there is none.
    """
    from sim.effects.library import applies, find_effect
    from sim.errors import ModelError

    if name.startswith(OWN):
        terms = own_terms() if terms is None else terms
        if name not in terms or not applies(terms[name], equations):
            raise DeclarationError(f"there is no term {name!r} for {equations.name}", where=f"{where}.name", remedy=f"use one of {', '.join(terms)}")
        return terms[name]
    try:
        return find_effect(name, equations)
    except ModelError as fault:
        raise DeclarationError(fault.what, where=f"{where}.name", remedy=fault.remedy) from None


def with_hidden(model: Model, hidden: tuple[HiddenTerm, ...], *, validation: bool) -> Model:
    """The vehicle with what is hidden in one of its two records.

    Raises
    ------
    DeclarationError : a parameter of a hidden term has no value.
    """
    for term in hidden:
        effect = find_term(term.name, model.equations, term.name)
        values = {**term.values, **(term.elsewhere if validation else {})}
        model = model.with_effects(effect).with_values({full_name(effect, local): value for local, value in values.items()})
    return model


def with_breakout(x29: X29, hidden: tuple[HiddenTerm, ...]) -> X29:
    """The closed loop with the break-out that is declared, in; none without a hidden term."""
    width = next((term.values["half_width"] for term in hidden if term.name == BREAKOUT), 0.0)
    return replace(x29, stick=replace(x29.stick, dead_band=width))
