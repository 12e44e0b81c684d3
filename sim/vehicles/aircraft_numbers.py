"""Mass, inertias and geometry that no aircraft has, or that are in other units.

Area is about span times chord, and radii of gyration lie in a narrow range [1]_; numbers outside
tell of feet, slugs or pounds.

References
----------
.. [1] D. P. Raymer, Aircraft Design: A Conceptual Approach, AIAA, table 16.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from sim.errors import DeclarationError

INERTIAS = ("roll_inertia", "pitch_inertia", "yaw_inertia")
POSITIVE = (
    "mass",
    "wing_area",
    "chord",
    "span",
    *INERTIAS,
    "air_density",
    "speed_of_sound",
)
# Area is about span times chord: their ratio is 1 of a rectangle, 4/3 of a triangle. Radii of
# gyration in roll are 0.2 to 0.4 of half the span (Raymer, Aircraft Design, table 16.1).
CHORD_TIMES_SPAN = (0.5, 2.5)  # of the area: wider than any wing
RADIUS = (0.1, 0.8)  # of gyration in roll, of half the span: wider than any aircraft
THINNEST = 0.003  # kg/m3, at 43 km; sea level in slug/ft3 is 0.0024
SOUND = (200.0, 500.0)  # m/s; 340 m/s are 661 kn and 1116 ft/s


def refuse_numbers(constants: Mapping[str, float], names: Iterable[str], where: str) -> None:
    """Raise DeclarationError, one line, for constants that no aircraft has.

    Parameters
    ----------
    constants : SI, by name.
    names : of all that have to be there.
    where : for the message.
    """
    c = constants
    for name in names:
        if name not in c:
            raise DeclarationError(f"the number {name} is missing", where=where, remedy="give it")
    for name in POSITIVE:
        if not 0.0 < c[name] < math.inf:
            raise DeclarationError(
                f"{name} = {c[name]:g} is not positive",
                where=where,
                remedy="give a positive number",
            )
    inertias = [c[name] for name in INERTIAS]
    if 2.0 * max(inertias) > sum(inertias):
        raise DeclarationError(
            "the largest inertia is larger than the sum of the other two, which no body has",
            where=where,
            remedy=f"check {', '.join(INERTIAS[:2])} and {INERTIAS[2]} and their units",
        )
    if c["cross_inertia"] ** 2 >= c["roll_inertia"] * c["yaw_inertia"]:
        raise DeclarationError(
            f"cross_inertia = {c['cross_inertia']:g} kg m2 is too large",
            where=where,
            remedy="its square is below roll_inertia yaw_inertia",
        )
    _refuse_other_units(c, where)


def _refuse_other_units(c: Mapping[str, float], where: str) -> None:
    """Raise DeclarationError for numbers that go together in other units only."""
    product = c["chord"] * c["span"]
    if not CHORD_TIMES_SPAN[0] < product / c["wing_area"] < CHORD_TIMES_SPAN[1]:
        raise DeclarationError(
            f"wing_area = {c['wing_area']:g} m2 is not that of chord {c['chord']:g} m and span "
            f"{c['span']:g} m, whose product is {product:.4g} m2",
            where=where,
            remedy='give all three in m, or with their units as in span = "70.5 ft"',
        )
    radius = 2.0 * math.sqrt(c["roll_inertia"] / c["mass"]) / c["span"]
    if not RADIUS[0] < radius < RADIUS[1]:
        raise DeclarationError(
            f"the radius of gyration in roll is {radius:.2g} of half the span, of aircraft 0.2 to "
            "0.4",
            where=where,
            remedy='check mass, span and roll_inertia; units are written as in mass = "1205 slug"',
        )
    if c["air_density"] < THINNEST:
        raise DeclarationError(
            f"air_density = {c['air_density']:g} kg/m3 is that of 43 km",
            where=where,
            remedy='write slugs as air_density = "0.0014 slug/ft3"',
        )
    if not SOUND[0] < c["speed_of_sound"] < SOUND[1]:
        raise DeclarationError(
            f"speed_of_sound = {c['speed_of_sound']:g} m/s is that of no air",
            where=where,
            remedy='write other units as speed_of_sound = "1116 ft/s"',
        )
