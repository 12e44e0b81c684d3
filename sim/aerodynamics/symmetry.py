"""Terms that the symmetry of an aircraft allows in its coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement

from sim.aerodynamics.terms import Factor, Term, parse_term

IN_SYMMETRY = ("CX", "CZ", "CD", "CL", "Cm")  # coefficients that a mirrored motion leaves alone
ALONG, ACROSS = ("alpha", "q"), ("beta", "p", "r")
ABOVE_SQUARES = ("alpha", "beta")  # signals with a cube


def sorted_surfaces(
    present: Mapping[str, set[Term]], surfaces: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Surfaces of the motion along the plane of symmetry, and of that across it."""
    sides: dict[str, set[bool]] = {name: set() for name in surfaces}
    for axis, terms in present.items():
        for term in terms:
            if len(term.signals) == 1 and (name := next(iter(term.signals))) in sides:
                sides[name].add(axis in IN_SYMMETRY)
    along = [name for name, side in sides.items() if side == {True}]
    across = [name for name, side in sides.items() if side == {False}]
    return along, across


def allowed_terms(along: Sequence[str], across: Sequence[str], *, symmetric: bool) -> list[Term]:
    """Terms that are even in what lies across the plane of symmetry, or odd.

    Parameters
    ----------
    along, across : surfaces of either motion. symmetric : True for even terms, those of lift, drag
        and pitching moment.

    Returns
    -------
    Linear terms, squares and products of two signals, cubes of the air's angles.

    Examples
    --------
    >>> [term.text for term in allowed_terms((), (), symmetric=False)][:4]
    ['beta', 'p', 'r', 'alpha*beta']
    """
    along, across = (*ALONG, *along), (*ACROSS, *across)
    single = along if symmetric else across
    found = [Term((Factor(name),)) for name in single]
    pairs = (
        [*combinations_with_replacement(along, 2), *((name, name) for name in across)]
        if symmetric
        else [(one, other) for one in along for other in across]
    )
    found += [
        Term((Factor(one, 2),)) if one == other else parse_term(f"{one}*{other}", (one, other))
        for one, other in pairs
    ]
    return found + [Term((Factor(name, 3),)) for name in single if name in ABOVE_SQUARES]
