"""Repeated flights on a page: shares of intervals that hold the truth, errors in reported sigmas and in the derivatives' units."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.pages.model import BY_ROW, Block, Column, Prose, Table
from scenarios.pages.numbers import PURE, Cell, Number, known
from scenarios.pages.printed import SIGMAS
from scenarios.studies.repeated import Scatter


def scattered_blocks(found: Sequence[Scatter]) -> list[Block]:
    """Two tables, and what was left out of them."""
    runs = sum(found[0].outcomes.values())
    shares = Column("within two sigmas", "%"), Column("from (95 %)", "%"), Column("to", "%")
    columns = (Column("flight"), Column("method"), Column("settled", PURE), *shares)
    rows = tuple(_shares(each) for each in found)
    labels = [f"{each.flight}: {each.estimation.label}" for each in found]
    units = {name: unit for each in found for name, unit in zip(each.names, each.units, strict=True)}
    in_units = tuple((name, *(_rms(each, name, sigmas=False) for each in found)) for name in units)
    in_sigmas = tuple((name, *(_rms(each, name, sigmas=True) for each in found)) for name in units)
    blocks: list[Block] = [
        Table(f"{runs} runs of each flight: intervals that hold the truth", columns, rows),
        Table("Root mean square error in reported sigmas", (Column("derivative"), *(Column(label, SIGMAS) for label in labels)), in_sigmas),
        Table("Root mean square error", (Column("derivative"), *(Column(label, BY_ROW) for label in labels)), in_units, tuple(units.values())),
    ]
    for each in found:
        others = ", ".join(f"{count} {code}" for code, count in sorted(each.outcomes.items()) if code != "converged")
        blocks += [Prose(f"{each.flight}, {each.estimation.label}: {others} of {runs} left out.", "note")] if others else []
    return blocks


def _shares(each: Scatter) -> tuple[Cell, ...]:
    share, (low, high) = each.within_two
    shares = (Number(100.0 * value, digits=0) for value in (share, low, high))
    return each.flight, each.estimation.label, Number(each.outcomes.get("converged", 0), digits=0), *shares


def _rms(each: Scatter, name: str, *, sigmas: bool) -> Cell:
    if name not in each.names:
        return "–"
    value = float((each.rms_sigmas if sigmas else each.rms)[each.names.index(name)])
    return known(value, 2 if sigmas else None)
