"""All terms that can be hidden: those of the scenarios, and those of this package."""

from __future__ import annotations

from collections.abc import Mapping

from scenarios.trials.planted_declaration import find_term, own_terms
from sim.declaration.effect import Effect
from sim.declaration.model import Equations


def every_term() -> Mapping[str, Effect]:
    """Return the terms that the effect library does not have, by name."""
    return {**own_terms(), **own_terms("exam.hidden_terms")}


def find_any_term(name: str, equations: Equations, where: str) -> Effect:
    """Return an effect of the library or one of ``every_term``; raise DeclarationError as
    ``find_term``.
    """
    return find_term(name, equations, where, every_term())
