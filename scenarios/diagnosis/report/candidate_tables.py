"""Candidates of a diagnosis as rows of tables: how the search ranked them, and what came of cross-validation."""

from __future__ import annotations

from ident.tracing.diagnosis import Candidate, Diagnosis, Quantity
from scenarios.terminal.display_units import in_hertz, spaced
from scenarios.terminal.quantities import displayed, with_sigma
from sim.declaration.traits import GUARD

STANDS = "cross-validated"
SHOWN = 6  # candidates of a round
TENFOLD = 9.0  # growth of an error, from which its size says nothing more


def candidate_rows(d: Diagnosis, count: int = SHOWN) -> list[tuple[str, ...]]:
    """The best candidates of each round at each set, by gain; of several forms of one effect the best."""
    rows: list[tuple[str, ...]] = []
    nodes = dict.fromkeys((candidate.round, candidate.within) for candidate in d.candidates)
    for node in nodes:
        group = [candidate for candidate in d.candidates if (candidate.round, candidate.within) == node]
        ranked = sorted(group, key=lambda c: (-c.gain, c.name))
        best = {candidate.name: candidate for candidate in reversed(ranked)}
        rows += [candidate_row(candidate) for candidate in ranked if best[candidate.name] is candidate][:count]
    return rows


def weighed_rows(d: Diagnosis) -> list[tuple[str, ...]]:
    """What was put to cross-validation, in the order of the error left: name, held-out change, the answer, parameters.

    What was asked twice, alone and again for a pair, is listed once: as cross-validated, if that is one of the answers.
    """
    answers = sorted((candidate for candidate in d.candidates if candidate.remark), key=lambda c: c.remark != STANDS)
    asked = list({(candidate.within, candidate.name): candidate for candidate in reversed(answers)}.values())
    asked.sort(key=lambda c: (len(c.within), c.held_out_change if c.held_out_change is not None else 0.0))
    cells = [candidate_row(candidate) for candidate in asked]
    return [(row[1], row[4], _answer(candidate), row[5]) for row, candidate in zip(cells, asked, strict=True)]


def _answer(c: Candidate) -> str:
    """What came of it; a guard helps, but is no physical effect and never a cause."""
    return "helps, but is no effect of the library" if c.name.startswith(GUARD) and c.remark == STANDS else c.remark


def candidate_row(c: Candidate) -> tuple[str, ...]:
    """Round, name, gain, p-value, held-out change, parameters, remarks."""
    held = _change(c.held_out_change)
    told = [f"{name} {with_sigma(quantity, name=name) if c.fitted else _estimate(name, quantity)}" for name, quantity in c.parameters.items()]
    parameters = ", ".join([*told[:3], *(["..."] if len(told) > 3 else [])])
    remarks = [] if c.fitted else ["screened"]
    remarks += [] if c.plausible else ["implausible"]
    others = [name for name in c.collinear_with if name != c.name]  # another form of it is no alternative
    remarks += [f"like {', '.join(others[:3])}"] if others else []
    remarks += [c.remark] if c.remark else []
    name = " + ".join((*c.within, c.name))
    chance = f"{c.p_value:.1g}" if c.p_value > 0.0 else "<1e-300"
    return str(c.round), name, f"{c.gain:.1f}", chance, held, parameters, "; ".join(remarks)


def _estimate(name: str, quantity: Quantity) -> str:
    value, _, unit = displayed(quantity, name)
    shown = f"{value:.1f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"  # a moment late in a record
    return f"about {shown}{spaced(unit)}{in_hertz(value, name, unit)}"


def _change(share: float | None) -> str:
    """A change of the held-out error in per cent; where a simulation runs away only that it is tenfold and more."""
    if share is None:
        return "-"
    return f"{100.0 * share:+.1f} %" if share < TENFOLD else "over +900 %"
