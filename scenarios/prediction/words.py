"""A prediction in lines for the terminal."""

from __future__ import annotations

from ident.tracing.diagnosis import Quantity
from scenarios.kept.kept_model import DIAGNOSE
from scenarios.prediction.predict import Prediction, Simulation
from scenarios.terminal.paragraphs import WIDTH, wrapped
from scenarios.terminal.quantities import displayed
from scenarios.terminal.tables import columns_of, table_lines

HEADINGS = ("", "channel", "rms error", "fit %", "R2", "Theil")
TITLE = "free simulation: initial states and biases alone are of the record itself"


def prediction_text(found: Prediction, width: int = WIDTH) -> str:
    """What was predicted with which model, warnings, and the errors channel by channel."""
    record, kept = found.record, found.kept
    effects = [effect.name for effect in kept.after.effects]
    told = f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s; {what_predicts(found)} ({found.study})"
    lines = wrapped(told, width)
    for warning in found.warnings:
        lines += wrapped(f"warning: {warning}", width)
    if kept.made_by == DIAGNOSE and effects and not kept.claimed:
        lines += wrapped("the effects are hints: the study claimed none of them", width)
    lines += table_lines(columns_of(HEADINGS, error_rows(found), left=2), title=TITLE, width=width, keys=2)
    for note in found.notes:
        lines += wrapped(f"note: {note}", width)
    return "\n".join(lines) + "\n"


def what_predicts(found: Prediction) -> str:
    """The model, whose it is, and the effects in it."""
    kept = found.kept
    effects = [effect.name for effect in kept.after.effects]
    return f"{kept.model} model of {found.vehicle}, from {kept.made_by}" + (f" with {' and '.join(effects)}" if effects else "")


def error_rows(found: Prediction) -> list[tuple[str, ...]]:
    """Cells below ``HEADINGS``: with the study's effects, and before that as declared where there are any."""
    before = _rows(found, found.before, "as declared") if found.before is not None and found.kept.after.effects else []
    return [*before, *_rows(found, found.after, "predicted")]


def _rows(found: Prediction, simulation: Simulation, word: str) -> list[tuple[str, ...]]:
    f = simulation.figures
    if f is None:
        return [(word, "-", "no finite simulation", "", "", "")]
    rows: list[tuple[str, ...]] = []
    for name, error in f.rmse.items():
        value, _, unit = displayed(Quantity(error, 0.0, found.record[name].unit))
        shown = f"{value:.3g} {unit}" if unit not in ("", "1") else f"{value:.3g}"
        rows.append((word, name, shown, f"{simulation.fit_percent(name):.1f}", f"{f.r2[name]:.4f}", f"{f.theil[name]:.3f}"))
    return rows
