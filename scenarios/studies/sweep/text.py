"""A sweep in the terminal: what each structure is, how far each method is off, and when a rigid model no longer serves."""

from __future__ import annotations

from rich.console import Console

from scenarios.studies.sweep.criteria import Criterion, criteria_of
from scenarios.studies.sweep.sweep import Sweep, SweepPoint
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.tables import Column, print_table

LEAST = -20  # logarithm of a probability below which its size says no more
HEADINGS = {"likelihood": "BIC gain of a mode", "whiteness": "p(white)", "misfit": ""}


def print_sweep(sweep: Sweep, out: Console) -> None:
    """The structures with the criteria's figures, errors of the six rigid derivatives by each method, and the criteria in words."""
    criteria = criteria_of(sweep.points)
    names = {mark.frequency_factor: mark.label for mark, _ in sweep.marks}
    factors = Column("frequencies", [f"{p.frequency_factor:g} {names.get(p.frequency_factor, '')}".strip() for p in sweep.points], left=True)
    degree = Column("degree", [f"{p.figures.degree:.4f}" for p in sweep.points])
    columns = [factors, degree, Column("stiffness lost", [f"{100 * p.figures.stiffness_loss:.1f} %" for p in sweep.points])]
    columns.append(Column("misfit/noise", [f"{p.figures.misfit:.2f}" for p in sweep.points]))
    columns += [Column(HEADINGS[each.name], [_shown(each.name, value) for value in each.values]) for each in criteria if HEADINGS[each.name]]
    print_table(out, "structures from stiff to soft", columns)
    for number, found in enumerate(sweep.points[0].methods):
        out.print()
        title = f"{found.estimation.label}: error against the condensed derivatives in % (in standard deviations)"
        rows = [Column(name, [_error(point, number, name) for point in sweep.points]) for name in sweep.rigid if name in found.names]
        print_table(out, title, [factors, *rows])
    out.print()
    for each in criteria:
        print_paragraph(out, criterion_sentence(each, sweep), indent=0)


def sweep_phrase(sweep: Sweep) -> str:
    """From which degree of flexibility on a rigid model fails each criterion, in one line."""
    told = [
        f"{each.name} from {each.degree:.3g} on" if each.degree is not None else f"{each.name} {_everywhere(each)}"
        for each in criteria_of(sweep.points)
    ]
    return f"degree of flexibility from which a rigid model fails: {', '.join(told)}"


def _everywhere(criterion: Criterion) -> str:
    fails = criterion.values[0] < criterion.limit if criterion.below else criterion.values[0] > criterion.limit
    return "on every structure" if fails else "on none"


def criterion_sentence(criterion: Criterion, sweep: Sweep) -> str:
    """From where on a rigid model fails the criterion."""
    if criterion.degree is None or criterion.frequency_factor is None:
        fails = criterion.values[0] < criterion.limit if criterion.below else criterion.values[0] > criterion.limit
        return f"{criterion.sentence}: {'on every structure of the sweep' if fails else 'on none of the sweep, or not from one on'}"
    first, last = sweep.points[0].figures.degree, sweep.points[-1].figures.degree
    where = f"from a degree of flexibility of {criterion.degree:.3g} on (frequencies by {criterion.frequency_factor:.3g})"
    return f"{criterion.sentence} {where}; the sweep goes from {first:.2g} to {last:.2g}"


def _shown(name: str, value: float) -> str:
    if name != "whiteness":
        return f"{value:.0f}"
    return f"{10.0**value:.2g}" if value > LEAST else f"< 1e{LEAST}"


def _error(point: SweepPoint, method: int, name: str) -> str:
    percent, sigmas = point.methods[method].errors(name)
    return f"{percent:+.1f} ({sigmas:+.1f})"
