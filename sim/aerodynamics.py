"""Coefficients of forces and moments as sums of terms, and the terms that symmetry allows.

A term is a product of powers and splines of signals. A vehicle file or a search names the terms.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

from sim.errors import DeclarationError
from sim.maths import absolute, maximum, real, where

ANGLES = ("alpha", "beta")
RATES = ("p", "q", "r")
FLOW = (*ANGLES, "mach", *RATES)  # signals of every aircraft; a vehicle file adds its surfaces
HIGHEST_POWER = 9
AS_TERM = "term_"  # prefix of signals on the bus in the form in which terms use them
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_NAME = r"[A-Za-z]\w*"
_SPLINE = re.compile(rf"spline\(({_NAME}),({_NUMBER}),(\d)\)")
_ABSOLUTE = re.compile(rf"abs\(({_NAME})\)")
_POWER = re.compile(rf"({_NAME})(?:\^(\d))?")
_FORMS = 'write "alpha", "alpha^2", "alpha*elevator", "abs(beta)" or "spline(alpha, 0.2, 1)"'


@dataclass(frozen=True, order=True)
class Factor:
    """A factor of a term: a power of a signal, its absolute value, or a spline.

    Attributes
    ----------
    signal : name of the signal.
    power : exponent, 1 to 9; of a spline 0 to 9.
    absolute : whether the factor is the absolute value of the signal.
    knot : knot of a spline in the unit of the signal: the factor is (signal - knot)^power above the
        knot and zero below it. None for other factors.
    """

    signal: str
    power: int = 1
    absolute: bool = False
    knot: float | None = None

    @property
    def text(self) -> str:
        """Text of the factor in a vehicle file."""
        if self.knot is not None:
            return f"spline({self.signal}, {self.knot:g}, {self.power})"
        if self.absolute:
            return f"abs({self.signal})"
        return self.signal if self.power == 1 else f"{self.signal}^{self.power}"

    @property
    def label(self) -> str:
        """Part of a parameter's name: letters, digits and underscores."""
        if self.knot is not None:
            number = f"{self.knot:g}".replace("-", "m").replace(".", "p").replace("+", "")
            return f"{self.signal}_above_{number}" + (f"_{self.power}" if self.power != 1 else "")
        if self.absolute:
            return f"abs_{self.signal}"
        return self.signal if self.power == 1 else f"{self.signal}{self.power}"

    def of(self, value: Any) -> Any:
        """Return the value of the factor.

        Parameters
        ----------
        value : value of the signal, also complex or an array; rates are non-dimensional.
        """
        if self.absolute:
            return absolute(value)
        if self.knot is None:
            return _raised(value, self.power)
        if self.power == 0:
            return 0.0 * value + where(real(value) > self.knot, 1.0, 0.0)
        return _raised(maximum(value - self.knot, 0.0 * value), self.power)


def _raised(value: Any, power: int) -> Any:
    """Return a power by multiplications, which keep the imaginary part of a complex step."""
    out = value
    for _ in range(power - 1):
        out = out * value
    return out


@dataclass(frozen=True, order=True)
class Term:
    """A product of factors; without factors it is the constant term.

    Examples
    --------
    >>> term = parse_term("alpha * elevator", ("alpha", "elevator"))
    >>> term.text, term.label
    ('alpha*elevator', 'alpha_elevator')
    >>> term.of({"alpha": 0.1, "elevator": -0.05})
    -0.005000000000000001
    """

    factors: tuple[Factor, ...] = ()

    @property
    def text(self) -> str:
        """Text of the term in a vehicle file."""
        return "*".join(factor.text for factor in self.factors) or "1"

    @property
    def label(self) -> str:
        """Part of a parameter's name; ``0`` for the constant term."""
        return "_".join(factor.label for factor in self.factors) or "0"

    @property
    def signals(self) -> frozenset[str]:
        """Names of the signals in the term."""
        return frozenset(factor.signal for factor in self.factors)

    def unit(self, angles: Collection[str]) -> str:
        """Return the unit of the term's coefficient: ``1/rad2`` for two factors of angles.

        Parameters
        ----------
        angles : signals whose derivatives are per radian: angles and rates.
        """
        power = sum(factor.power for factor in self.factors if factor.signal in angles)
        return "1" if power == 0 else "1/rad" if power == 1 else f"1/rad{power}"

    def of(self, values: Mapping[str, Any]) -> Any:
        """Return the term's value.

        Parameters
        ----------
        values : signal -> value, a number or an array of one shape, real or complex.
        """
        out: Any = 1.0
        for place, factor in enumerate(self.factors):
            value = factor.of(values[factor.signal])
            out = value if place == 0 else out * value
        return out


class TermTable:
    """Evaluation of many terms, in which each power and each product is computed once.

    Parameters
    ----------
    terms : the terms in the order of the values; a term may occur more than once.

    Examples
    --------
    >>> terms = [parse_term(text, ("alpha", "q")) for text in ("alpha^2", "alpha^2*q")]
    >>> TermTable(terms).values({"alpha": 3.0, "q": 2.0})
    [9.0, 18.0]
    """

    def __init__(self, terms: Sequence[Term]) -> None:
        self._steps: list[Factor | tuple[int, int]] = []  # a factor, or a product of two steps
        self._known: dict[Factor | tuple[Factor, ...], int] = {}
        self._places = [self._place_of(term.factors) if term.factors else None for term in terms]

    def values(self, signals: Mapping[str, Any]) -> list[Any]:
        """Return the values of the terms, bit for bit those of ``Term.of``.

        Parameters
        ----------
        signals : signal -> value, a number or an array of one shape, real or complex.
        """
        result: list[Any] = []
        for step in self._steps:
            if isinstance(step, Factor):
                result.append(step.of(signals[step.signal]))
            else:
                result.append(result[step[0]] * result[step[1]])
        return [1.0 if place is None else result[place] for place in self._places]

    def _place_of(self, factors: tuple[Factor, ...]) -> int:
        """Return the index of the step that computes a product of factors."""
        if len(factors) == 1:
            return self._factor(factors[0])
        if factors not in self._known:
            self._add(factors, (self._place_of(factors[:-1]), self._factor(factors[-1])))
        return self._known[factors]

    def _factor(self, factor: Factor) -> int:
        """Return the index of the step that computes a factor, a power from the next lower one."""
        if factor not in self._known:
            power = factor.knot is None and not factor.absolute and factor.power > 1
            if power:
                below = self._factor(replace(factor, power=factor.power - 1))
                self._add(factor, (below, self._factor(replace(factor, power=1))))
            else:
                self._add(factor, factor)
        return self._known[factor]

    def _add(self, key: Factor | tuple[Factor, ...], step: Factor | tuple[int, int]) -> None:
        self._known[key] = len(self._steps)
        self._steps.append(step)


def parse_term(text: str, signals: Collection[str], where: str = "term") -> Term:
    """Return a term from its text.

    Parameters
    ----------
    text : text such as ``"alpha*elevator"``, ``"alpha^2"`` or ``"spline(alpha, 0.2, 1)"``.
    signals : names of the signals that the text may have.
    where : file and key of the text, for messages.

    Raises
    ------
    DeclarationError : the text is no term, or has an unknown signal.

    Examples
    --------
    >>> parse_term("spline(alpha, 0.2, 1)*beta", ("alpha", "beta")).label
    'alpha_above_0p2_beta'
    """
    compact = re.sub(r"\s+", "", text)
    if compact == "1":
        return Term()
    factors: dict[tuple[str, bool, float | None, int], Factor] = {}
    for part in _parts(compact):
        factor = _factor(part, text, where)
        if factor.signal not in signals:
            raise DeclarationError(
                f"the term {text!r} has the unknown signal {factor.signal}",
                where=where,
                remedy=f"use {', '.join(signals)}, or declare it under [surfaces]",
            )
        is_power = factor.knot is None and not factor.absolute
        key = (factor.signal, factor.absolute, factor.knot, 0 if is_power else factor.power)
        if key in factors and is_power:
            factor = Factor(factor.signal, factor.power + factors[key].power)
        if (key in factors and not is_power) or factor.power > HIGHEST_POWER:
            raise DeclarationError(
                f"the term {text!r} is no product of powers up to {HIGHEST_POWER}",
                where=where,
                remedy="write each factor once",
            )
        factors[key] = factor
    return Term(tuple(sorted(factors.values(), key=_order)))


def _order(factor: Factor) -> tuple[int, str, bool, float, int]:
    """Return the sort key of a factor, so that a product has one name.

    Signals in ``FLOW`` come first, then surfaces by name.
    """
    place = FLOW.index(factor.signal) if factor.signal in FLOW else len(FLOW)
    knot = -math.inf if factor.knot is None else factor.knot
    return place, factor.signal, factor.absolute, knot, factor.power


def _parts(compact: str) -> list[str]:
    """Return the factors of a text: the parts between asterisks that are outside of brackets."""
    parts, depth = [""], 0
    for letter in compact:
        depth += (letter == "(") - (letter == ")")
        if letter == "*" and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _factor(part: str, text: str, where: str) -> Factor:
    """Return the factor of a ``part`` of the term ``text``."""
    if match := _SPLINE.fullmatch(part):
        return Factor(match[1], int(match[3]), knot=float(match[2]))
    if match := _ABSOLUTE.fullmatch(part):
        return Factor(match[1], absolute=True)
    match = _POWER.fullmatch(part)
    if match is None or match[2] == "0":
        raise DeclarationError(f"{text!r} is no term", where=where, remedy=_FORMS)
    return Factor(match[1], int(match[2] or 1))


IN_SYMMETRY = ("CX", "CZ", "CD", "CL", "Cm")  # coefficients that are equal in a mirrored motion
ALONG = ("alpha", "q")  # variables of the longitudinal motion
ACROSS = ("beta", "p", "r")  # variables of the lateral motion
_ALONG = (*ALONG, "mach")
ABOVE_SQUARES = ("alpha", "beta")  # signals whose cube is offered as a term


def sorted_surfaces(
    present: Mapping[str, set[Term]], surfaces: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Return the surfaces of the longitudinal motion, and those of the lateral motion.

    Parameters
    ----------
    present : terms of each coefficient. A surface belongs to the motion whose coefficients have it
        as a term of its own.
    surfaces : names of the surfaces.
    """
    sides: dict[str, set[bool]] = {name: set() for name in surfaces}
    for axis, terms in present.items():
        for term in terms:
            if len(term.signals) == 1 and (name := next(iter(term.signals))) in sides:
                sides[name].add(axis in IN_SYMMETRY)
    along = [name for name, side in sides.items() if side == {True}]
    across = [name for name, side in sides.items() if side == {False}]
    return along, across


def parents(term: Term) -> frozenset[Term]:
    """Return the linear terms that a hierarchical model must have before it may have a product.

    Parameters
    ----------
    term : a product, a power or a spline.

    Returns
    -------
    Linear terms of its signals that have the symmetry of the product: the other factors are equal
    in a mirrored motion. Products of two surfaces have none, since their symmetry is not known.

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
    result = {name for name, power in sideways.items() if _others_even(sideways, name, power)}
    result |= {name for name in powers if name in _ALONG and not _odd(sideways)}
    return frozenset(Term((Factor(name),)) for name in result)


def is_linear(term: Term, axis: str) -> bool:
    """Return whether a term is a single signal that symmetry allows in a coefficient.

    Parameters
    ----------
    term : the term.
    axis : the coefficient. Surfaces are allowed in every one, since their symmetry is not known.

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
    """Return whether the factors that multiply a signal are unchanged in a mirrored motion."""
    return power % 2 == 1 and not _odd({n: other for n, other in powers.items() if n != name})


def _odd(powers: Mapping[str, int]) -> bool:
    return any(power % 2 for power in powers.values())


def allowed_terms(along: Sequence[str], across: Sequence[str], *, symmetric: bool) -> list[Term]:
    """Return the terms that are even, or odd, in the variables of the lateral motion.

    Parameters
    ----------
    along, across : surfaces of the longitudinal and of the lateral motion.
    symmetric : True for even terms, those of lift, drag and pitching moment.

    Returns
    -------
    Linear terms, squares and products of two signals, and cubes of the flow angles.

    Examples
    --------
    >>> [term.text for term in allowed_terms((), (), symmetric=False)][:4]
    ['beta', 'p', 'r', 'alpha*beta']
    """
    along, across = (*ALONG, *along), (*ACROSS, *across)
    single = along if symmetric else across
    terms = [Term((Factor(name),)) for name in single]
    pairs = (
        [*combinations_with_replacement(along, 2), *((name, name) for name in across)]
        if symmetric
        else [(one, other) for one in along for other in across]
    )
    terms += [
        Term((Factor(one, 2),)) if one == other else parse_term(f"{one}*{other}", (one, other))
        for one, other in pairs
    ]
    return terms + [Term((Factor(name, 3),)) for name in single if name in ABOVE_SQUARES]
