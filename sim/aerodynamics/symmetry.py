"""Terms that the symmetry of an aircraft allows in its coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement

from sim.aerodynamics.terms import Factor, Term, parse_term

IN_SYMMETRY = ("CX", "CZ", "CD", "CL", "Cm")  # coefficients that a mirrored motion leaves alone
ALONG, ACROSS = ("alpha", "q"), ("beta", "p", "r")
_ALONG = (*ALONG, "mach")
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


def parents(term: Term) -> frozenset[Term]:
    """Linear terms without which a product has no place in a hierarchical model.

    Parameters
    ----------
    term : a product, a power or a spline.

    Returns
    -------
    Linear terms of its signals with its symmetry: what multiplies them is not changed by a mirrored
    motion. Products of two surfaces have none, since their symmetry is not known.

    References
    ----------
    J. A. Nelder, A reformulation of linear models, Journal of the Royal Statistical Society A
    140(1), 1977 (marginality).

    Examples
    --------
    >>> signals = ("alpha", "beta", "p", "aileron")
    >>> [each.text for each in parents(parse_term("aileron*abs(aileron)", signals))]
    ['aileron']
    >>> [each.text for each in parents(parse_term("alpha*p", signals))]
    ['p']
    >>> parents(parse_term("beta^2", signals))
    frozenset()
    """
    powers: dict[str, int] = {}
    for factor in term.factors:
        if not factor.absolute:
            powers[factor.signal] = powers.get(factor.signal, 0) + max(factor.power, 1)
    sideways = {name: power for name, power in powers.items() if name not in _ALONG}
    if sum(powers.values()) + sum(factor.absolute for factor in term.factors) < 2:
        return frozenset()
    found = {name for name, power in sideways.items() if _others_even(sideways, name, power)}
    found |= {name for name in powers if name in _ALONG and not _odd(sideways)}
    return frozenset(Term((Factor(name),)) for name in found)


def is_linear(term: Term, axis: str) -> bool:
    """Whether a term is a signal alone that the symmetry of the aircraft allows in a coefficient.

    Parameters
    ----------
    term : any. axis : the coefficient. Surfaces are allowed in all of them: their symmetry is not
        known.

    Examples
    --------
    >>> signals = ("alpha", "beta", "aileron")
    >>> is_linear(parse_term("beta", signals), "Cl"), is_linear(parse_term("beta", signals), "Cm")
    (True, False)
    """
    if len(term.factors) != 1:
        return False
    factor = term.factors[0]
    if factor.absolute or factor.knot is not None or factor.power != 1:
        return False
    return factor.signal not in (ACROSS if axis in IN_SYMMETRY else _ALONG)


def _others_even(powers: Mapping[str, int], name: str, power: int) -> bool:
    """Whether what multiplies a signal is the same in a mirrored motion."""
    return power % 2 == 1 and not _odd({n: other for n, other in powers.items() if n != name})


def _odd(powers: Mapping[str, int]) -> bool:
    return any(power % 2 for power in powers.values())


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
