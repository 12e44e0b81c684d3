"""The library finds every effect file, names it, keeps guards apart, and offers to a vehicle what
it can carry.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import sim.effects.input_path
from sim.declaration.proposal import GUARD, Traceable
from sim.effects.library import (
    applies,
    effect_modules,
    effect_names,
    effects_for,
    find_effect,
    library,
)
from sim.errors import ModelError
from sim.vehicles.other_vehicles import Ballistic
from sim.vehicles.uncoupled import ShortPeriod
from tests.bases import base_for
from tests.effect_cases import GUARDS, OFFERED, OFFERED_GUARDS
from tests.offered import made

ROOT = Path(__file__).parents[2]
# Files with the effects of one family; every other file has one effect, in whatever variants.
FAMILIES = {
    "actuator": {
        "actuator-lag",
        "actuator-second-order",
        "actuator-rate-limit",
        "actuator-saturation",
    },
    "airspeed": {"phugoid", "speed-variation"},
    "atmosphere": {"density-scale-height", "drag-mach"},
    "derivative_jump": {"derivative-jump", "drag-jump"},
    "gusts": {"gust-discrete", "gust-horizontal", "gust-turbulence"},
    "input_delay": {"input-delay", "input-recorded-late"},
    "input_play": {"input-backlash", "input-deadband"},
    "load_nonlinearity": {
        "flow-separation",
        *(
            f"{load}-nonlinearity"
            for load in ("drag", "lift", "moment", "roll", "side-force", "yaw")
        ),
    },
    "sensor_calibration": {"sensor-scale", "sensor-curve", "sensor-drift", "sensor-step"},
    "sensor_mounting": {"accelerometer-offset", "vane-offset", "sensor-coupling"},
    "sensor_play": {"sensor-backlash", "sensor-deadband"},
    "sensor_timing": {"sensor-delay", "sensor-lag", "sensor-hold", "time-base"},
    "varies": {"missing-term", "varies"},
}


def files() -> Iterator[str]:
    """Dotted names of the modules in the station folders and the folders in them, by file."""
    for path in sorted((ROOT / "sim" / "effects").glob("*/**/*.py")):
        if path.stem != "__init__" and path.parent.name != "guards":
            yield ".".join(path.relative_to(ROOT).with_suffix("").parts)


def test_every_file_of_the_station_folders_is_in_the_library() -> None:
    assert {module.__name__ for module in effect_modules()} == {*files()}


def test_every_effect_of_the_library_is_covered() -> None:
    covered = {effect for effect, _ in OFFERED}
    assert covered >= {*library()}, "a vehicle is missing from tests/offered.py and tests/bases.py"
    # Of what is made from a declaration one instance of every stem is flown.
    assert {effect.name.partition(":")[0] for effect in made()} <= {
        effect.name.partition(":")[0] for effect in covered - {*library()}
    }


@pytest.mark.parametrize("module", effect_modules(), ids=lambda module: module.__name__)
def test_lies_in_the_folder_of_its_station(module: ModuleType) -> None:
    """And each file has one effect, in whatever variants, or those of one family."""
    folder, file = module.__name__.split(".")[2], module.__name__.rpartition(".")[2]
    assert {effect.station.name.lower() for effect in module.VARIANTS} == {folder}
    stems = {effect.name.partition(":")[0] for effect in module.VARIANTS}
    assert stems == FAMILIES[file] if file in FAMILIES else len(stems) == 1


def test_effects_of_a_family_are_listed_under_their_own_names() -> None:
    names = [name for name in effect_names() if name.endswith(("-nonlinearity", "-separation"))]
    assert names == sorted(names) and len(names) == 8


def test_a_new_file_is_a_new_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        sim.effects.input_path, "__path__", [*sim.effects.input_path.__path__, str(tmp_path)]
    )
    (tmp_path / "input_twin.py").write_text(
        "from sim.effects.input_path.input_delay import InputDelay\nVARIANTS = "
        "(InputDelay('twin'),)\n"
    )
    assert any(getattr(effect, "signal", None) == "twin" for effect in library())
    (tmp_path / "input_void.py").write_text("")
    with pytest.raises(ModelError, match="input_void"):
        library()


def test_guards_stand_apart_from_the_library() -> None:
    names = {guard.name for guard, _ in OFFERED_GUARDS}
    products, loads = (
        ("alpha-control", "control-squared", "alpha-q"),
        ("lagged-loads", "periodic-loads", "damping-curve", "drifting-derivatives"),
    )
    lateral = (
        "beta-rudder",
        "beta-aileron",
        "beta-p",
        "beta-r",
        "rudder-squared",
        "aileron-squared",
    )
    labelled = (
        "damping-curve:p",
        "damping-curve:r",
        "drifting-derivatives:yaw",
        "drifting-derivatives:roll",
    )
    assert names == {
        f"{GUARD}{label}"
        for label in (
            *products,
            *loads,
            *lateral,
            *labelled,
            "control-drag",
            "drag-drift",
            "hysteresis",
            "vane-behind",
            "vane-near-control",
        )
    }
    assert names.isdisjoint(effect_names())
    assert all(case.values[0].traits.guard for case in GUARDS)  # type: ignore[union-attr]
    assert not any(
        effect.traits.guard or effect.name.startswith(GUARD)
        for effect in library()
        if isinstance(effect, Traceable)
    )
    modules = {path.stem for path in (ROOT / "sim" / "effects" / "guards").glob("*.py")} - {
        "__init__"
    }
    assert {type(case.values[0]).__module__.rpartition(".")[2] for case in GUARDS} == modules
    with pytest.raises(ModelError):
        find_effect("guard:alpha-q")


def test_library_finds_by_name_and_by_vehicle() -> None:
    assert len(set(effect_names())) == len(effect_names())
    for name in effect_names():
        assert find_effect(name).name == name
    assert find_effect("elastic-mode").name == "elastic-mode"
    assert not applies(find_effect("gust-discrete"), Ballistic())
    assert find_effect("sensor-lag:altitude", Ballistic()) in effects_for(Ballistic())
    with pytest.raises(ModelError, match=r"sensor-lag:alpha, sensor-lag:q"):
        find_effect("sensor-lag", ShortPeriod())
    with pytest.raises(ModelError, match="did you mean 'input-delay'"):
        find_effect("input_dealy")
    with pytest.raises(ModelError, match="use one of"):
        find_effect("zzzz")


@pytest.mark.long
def test_an_effect_refuses_a_vehicle_without_its_port() -> None:
    model, _ = base_for("ballistic")
    with pytest.raises(ModelError, match=r"gust-discrete needs the port 'gust'.*log_density"):
        model.with_effects(find_effect("gust-discrete"))


def test_applies_reads_signal_channel_and_needs() -> None:
    vehicle = ShortPeriod()
    told = [
        ({}, True),
        ({"signal": "stick"}, False),
        ({"channel": "nz"}, True),
        ({"needs": ("lift", "wind")}, False),
    ]
    told += [({"rates_read": ("q",)}, True), ({"rates_read": ("r",)}, False)]
    for attributes, expected in told:
        assert applies(SimpleNamespace(**attributes), vehicle) is expected  # type: ignore[arg-type]
