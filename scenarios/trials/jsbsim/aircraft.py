"""The aircraft of the JSBSim package: which there are, where they trim, and which property of each surface their air loads read."""

from __future__ import annotations

import importlib.util
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from scenarios.files.declarations import closest
from scenarios.trials.jsbsim.declaration import SURFACES
from sim.errors import DeclarationError

FOOT, KNOT = 0.3048, 1852.0 / 3600.0
REMEDY = "pip install 'flightid[jsbsim]'"


def _at(feet: float, knots: float) -> tuple[float, float]:
    return feet * FOOT, knots * KNOT


# Altitude (m) and true airspeed (m/s) of level flight that stays level, in the middle of each envelope.
CONDITIONS: Mapping[str, tuple[float, float]] = {
    **{"c172x": _at(5000, 105), "c172p": _at(5000, 105), "t6texan2": _at(8000, 220), "OV10": _at(5000, 210)},
    **{"A320": _at(20000, 380), "MD11": _at(20000, 400), "737": _at(20000, 380), "B747": _at(20000, 400), "fokker100": _at(15000, 260)},
    **{"F4N": _at(15000, 430), "T38": _at(15000, 380), "T37": _at(12000, 280), "f104": _at(20000, 520), "Concorde": _at(20000, 480)},
}
_PUSHBACK = tuple(f"/sim/model/pushback/{name}" for name in ("position-norm", "kp", "ki", "kd", "force", "target-speed-fps"))
# Properties of another program that an aircraft's files read and that must exist.
NEEDS: Mapping[str, tuple[str, ...]] = {"fokker100": ("/gear/gear/wow", *_PUSHBACK), "f104": ("systems/radar/range",)}
# Travel (rad) of a surface that is given in parts of it only; 20 degrees where nothing is known.
TRAVEL: Mapping[tuple[str, str], float] = {("T38", "elevator"): 0.297}
USUAL_TRAVEL = math.radians(20.0)


@dataclass(frozen=True)
class Surface:
    """The property that the air loads read, and what it is to be multiplied with to be radians."""

    property: str
    scale: float


def package_folder() -> Path:
    """Where JSBSim is installed; DeclarationError where it is not."""
    found = importlib.util.find_spec("jsbsim")
    if found is None or found.origin is None:
        raise DeclarationError("JSBSim is not installed, and this flight is one of its", where="flightid simulate", remedy=REMEDY)
    return Path(found.origin).parent


def known_aircraft(name: str, where: str) -> None:
    """DeclarationError where the package has no such aircraft."""
    names = sorted(path.name for path in (package_folder() / "aircraft").iterdir() if (path / f"{path.name}.xml").is_file())
    if name not in names:
        raise DeclarationError(f"JSBSim has no aircraft {name!r}", where=where, remedy=closest(name, names))


def surfaces_of(name: str) -> dict[str, Surface]:
    """Of each surface the property that the air loads of an aircraft read most often; one that they never read is left out."""
    counted = Counter(_read_by_loads(package_folder() / "aircraft" / name / f"{name}.xml"))
    found = {}
    for surface in SURFACES:
        mine = [(count, prop) for prop, count in counted.items() if surface in prop and "mag-" not in prop and "cmd" not in prop]
        if mine:
            prop = max(mine)[1]
            found[surface] = Surface(prop, _scale(name, surface, prop))
    return found


def _scale(name: str, surface: str, prop: str) -> float:
    if prop.endswith("-norm"):
        return TRAVEL.get((name, surface), USUAL_TRAVEL)
    return math.radians(1.0) if prop.endswith("-deg") else 1.0


def _read_by_loads(path: Path) -> Iterator[str]:
    """Every property that an aircraft's aerodynamics read, as often as they do."""
    for section in ElementTree.parse(path).getroot().iter("aerodynamics"):
        other = section.get("file")
        if other:
            section = ElementTree.parse((path.parent / other).with_suffix(".xml")).getroot()
        for element in section.iter():
            if element.tag in ("property", "independentVar", "p") and element.text:
                yield element.text.strip().lstrip("-")
