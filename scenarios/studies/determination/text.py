"""What records and priors determine, in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from scenarios.studies.determination.determine import MethodDetermination
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.tables import Column, print_table

KEPT = 0.95  # of the prior's deviation: above it a record has said nothing to speak of
SHOWN = 3  # directions of each kind that are named


def print_determination(methods: Sequence[MethodDetermination], out: Console) -> None:
    """Of each parameter the deviation left of the prior's and the share of its variance that the prior gives, all methods beside each other."""
    first = methods[0].found
    ratio = [dict(zip(m.found.names, (m.found.posterior_std / m.found.prior_std).tolist(), strict=True)) for m in methods]
    share = [dict(zip(m.found.names, m.found.prior_share.tolist(), strict=True)) for m in methods]
    shown = [name for name in first.names if any(each.get(name, 1.0) < KEPT for each in ratio)]
    shown.sort(key=lambda name: ratio[0][name])
    labels = [method.estimation.name for method in methods]
    left = [Column(f"{a}, sigma", [f"{each[name]:.3f}" if name in each else "-" for name in shown]) for a, each in zip(labels, ratio, strict=True)]
    right = [
        Column(f"{a}, prior", [f"{100 * each[name]:.0f} %" if name in each else "-" for name in shown]) for a, each in zip(labels, share, strict=True)
    ]
    print_table(out, "sigma over the prior's, and share of the variance that the prior gives", [Column("parameter", shown, left=True), *left, *right])
    rest = len(first.names) - len(shown)
    if rest:
        print_paragraph(out, f"the other {rest} of {len(first.names)} parameters keep more than {KEPT:g} of their prior's sigma with every method", 0)
    for method in methods:
        out.print()
        for sentence in determination_sentences(method):
            print_paragraph(out, sentence, 0)


def determination_sentences(method: MethodDetermination) -> tuple[str, ...]:
    """How many numbers the record settles, the directions it knows best and least, and what the method claims beyond it."""
    found, label = method.found, method.estimation.name
    seen = len(found.names) - found.unseen
    said = [
        f"{label}: of {len(found.names)} parameters the record shows {seen} directions and knows {found.determined} of them better than the prior "
        f"does ({found.effective:.1f} numbers settled); along {found.unseen} directions the outputs do not change at all, whatever the noise"
    ]
    best, least = range(min(SHOWN, seen)), range(max(seen - SHOWN, 0), seen)
    said.append(f"{label}: known best: {'; '.join(_direction(method, at) for at in best)}")
    said.append(f"{label}: seen least: {'; '.join(_direction(method, at) for at in least)}")
    if method.overclaimed:
        few = ", ".join(method.overclaimed[:8]) + (", ..." if len(method.overclaimed) > 8 else "")
        said.append(f"{label}: claims {len(method.overclaimed)} parameters better than record and prior allow: {few}")
    return tuple(said)


def _direction(method: MethodDetermination, at: int) -> str:
    parts = method.found.composition(at, 3)
    named = " ".join(f"{part:+.2f} {name}" for name, part in parts)
    return f"{method.found.strengths[at]:.2g} times the prior ({named.removeprefix('+')})"
