"""What there is: effects, models, vehicles and scenarios, each as a table."""

from __future__ import annotations

from scenarios.api.shown.table import Table

TITLES = {
    "ballistic": "a falling body: altitude from drag in an atmosphere that thins out",
    "rigid": "the short period of a rigid aircraft: alpha and q from elevator",
    "flexible": "the short period with elastic modes",
    "loes": "low-order equivalent system: alpha, q from the stick, a delay",
    "lateral": "sideslip, roll and yaw from aileron and rudder",
    "longitudinal": "airspeed, alpha, attitude and q from elevator and thrust",
    "multirotor": "roll, pitch and yaw rates and az from commands to the motors",
}


def effects() -> Table:
    """The library of effects: name, station, what it is, its parameters."""
    from sim.effects.library import effect_names, find_effect

    rows = []
    for name in effect_names():
        effect = find_effect(name)
        told = " ".join(effect.explanation.split())
        rows.append((name, effect.station.value, told, tuple(f"{item.name} ({item.unit})" for item in effect.parameters)))
    return Table("effects", ("effect", "station", "explanation", "parameters"), tuple(rows))


def models() -> Table:
    """The models: name, what it is, inputs, outputs, what a vehicle file gives and what is estimated."""
    from scenarios.files.vehicles import MODELS
    from sim.vehicles.factory import FAMILIES

    rows = []
    for name in MODELS:
        equations, constants, derivatives = FAMILIES["rigid" if name == "flexible" else name]
        signals = (tuple(signal.name for signal in some) for some in (equations.inputs, equations.outputs))
        rows.append((name, TITLES[name], *signals, tuple(constants), tuple(derivatives)))
    return Table("models", ("model", "what it is", "inputs", "outputs", "constants", "parameters"), tuple(rows))


def vehicles() -> Table:
    """The library of vehicles: name, what it is, its equations, where the numbers are from."""
    from sim.vehicles.library import read_parameter_set, vehicle_names

    sets = [read_parameter_set(name) for name in vehicle_names()]
    rows = tuple((each.name, each.title, each.equations, each.source) for each in sets)
    return Table("vehicles", ("vehicle", "what it is", "equations", "source"), rows)


def scenarios() -> Table:
    """The catalogue of scenarios: name, kind, title."""
    from scenarios.studies.catalogue import scenario_kind, scenario_names, scenario_title

    return Table("scenarios", ("scenario", "kind", "title"), tuple((name, scenario_kind(name), scenario_title(name)) for name in scenario_names()))
