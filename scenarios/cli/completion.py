"""What a shell completes: names of scenarios, models, methods, effects and vehicles. Where nothing is said here it completes files."""

from __future__ import annotations

from collections.abc import Callable, Iterable

# Said here once more, so that neither help nor completion loads what computes; a test holds both against the lists that count.
MODEL_NAMES = ("ballistic", "rigid", "flexible", "loes", "lateral", "longitudinal", "multirotor")
METHOD_NAMES = ("output-error", "filter-error", "frequency-domain", "equation-error", "ekf", "ukf")


def scenarios(incomplete: str) -> list[str]:
    """Scenarios of the catalogue."""
    from scenarios.studies.catalogue import scenario_names

    return _beginning(scenario_names(), incomplete)


def models(incomplete: str) -> list[str]:
    """Built-in models."""
    return _beginning(MODEL_NAMES, incomplete)


def methods(incomplete: str) -> list[str]:
    """Methods of identification."""
    return _beginning(METHOD_NAMES, incomplete)


def effects(incomplete: str) -> list[str]:
    """Effects of the library."""
    from sim.effects.library import effect_names

    return _beginning(effect_names(), incomplete)


def vehicles(incomplete: str) -> list[str]:
    """Vehicles of the library."""
    from sim.vehicles.library import vehicle_names

    return _beginning(vehicle_names(), incomplete)


def of(*words: str) -> Callable[[str], list[str]]:
    """A completion with a few fixed words."""

    def complete(incomplete: str) -> list[str]:
        return _beginning(words, incomplete)

    return complete


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
