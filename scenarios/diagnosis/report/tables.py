"""Rows of the tables of a diagnosis: errors and derivatives before and after; candidates."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ident.tracing.diagnosis import Candidate, Diagnosis, Quantity
from scenarios.diagnosis.noise_words import is_coloured, noise_headings, residual_levels
from scenarios.diagnosis.report.declared_only import nothing_stands
from scenarios.diagnosis.report.evidence import scatter_rows
from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.terminal.quantities import is_frequency, shown_in, value_text, with_sigma

MOVED = 2.0  # sigmas
SIGMA_NOTE = "+- sigma, widened by the scatter between records"
DERIVED_HEADINGS = ("unit", "before", "after", "moved by")
SHOWN = 6  # candidates of a round


def candidate_rows(d: Diagnosis, count: int = SHOWN) -> list[tuple[str, ...]]:
    """The best candidates of each round at each set, by gain; of several forms of one effect the
    best.
    """
    rows: list[tuple[str, ...]] = []
    nodes = dict.fromkeys((candidate.round, candidate.within) for candidate in d.candidates)
    for node in nodes:
        group = [
            candidate for candidate in d.candidates if (candidate.round, candidate.within) == node
        ]
        ranked = sorted(group, key=lambda c: (-c.gain, c.name))
        best = {candidate.name: candidate for candidate in reversed(ranked)}
        rows += [
            candidate_row(candidate) for candidate in ranked if best[candidate.name] is candidate
        ][:count]
    return rows


def candidate_row(c: Candidate) -> tuple[str, ...]:
    """Round, name, gain, gain with prior odds, parameters, remarks."""
    told = [f"{name} {with_sigma(quantity, name=name)}" for name, quantity in c.parameters.items()]
    parameters = ", ".join([*told[:3], *(["..."] if len(told) > 3 else [])])
    remarks = [] if c.fitted else ["linearised"]
    # another form of it is no alternative
    others = [name for name in c.collinear_with if name != c.name]
    remarks += [f"like {', '.join(others[:3])}"] if others else []
    name = " + ".join((*c.within, c.name))
    return str(c.round), name, f"{c.gain:.1f}", f"{c.weight:.1f}", parameters, "; ".join(remarks)


def error_headings(d: Diagnosis) -> tuple[str, ...]:
    """Headings of ``error_rows`` behind the channel."""
    return ("unit", "before", "after", *noise_headings(d))


def error_rows(d: Diagnosis, units: Mapping[str, str] = CHANNEL_UNITS) -> list[tuple[str, ...]]:
    """Channel, unit, error before and after, what the fit leaves where it is not the noise, and the
    noise; angles and their rates in degrees.
    """
    rows: list[tuple[str, ...]] = []
    left = residual_levels(d)
    for channel, before in d.error_before.rmse.items():
        factor, unit = shown_in(units.get(channel, ""), channel)
        noise = (
            *([left.get(channel, math.nan)] if is_coloured(d) else []),
            d.noise_floor.get(channel, math.nan),
        )
        shown = (before, d.error_after.rmse.get(channel, math.nan), *noise)
        rows.append((channel, unit, *(short(factor * value) for value in shown)))
    return rows


def derivative_headings(d: Diagnosis) -> tuple[str, ...]:
    """Headings of ``derivative_rows`` behind the name, with a column of the scatter where it is
    known.
    """
    return ("unit", "before", "after", *(["run-to-run"] if d.scatter else []), "moved by")


def derivative_rows(
    before: Mapping[str, Quantity],
    after: Mapping[str, Quantity],
    scatter: Mapping[str, float] | None = None,
) -> list[tuple[str, ...]]:
    """Name, unit, value +- sigma before and after, run-to-run scatter where any is known, the move
    in sigmas of both (marked beyond two).
    """
    rows: list[tuple[str, ...]] = []
    for name, old in before.items():
        new = after.get(name)
        if new is None:
            continue
        sigmas = moved(old, new)
        mark = " *" if abs(sigmas) > MOVED else "  "
        move = f"{sigmas:+.1f} sigma{mark}" if abs(sigmas) >= 0.05 else "-  "
        unit = old.unit if old.unit != "1" else ""
        rows.append(
            (
                name,
                unit,
                value_text(old.value, old.std),
                value_text(new.value, new.std),
                *(scatter_rows(scatter, [name]) if scatter else []),
                move,
            )
        )
    return rows


def derived_of(d: Diagnosis) -> tuple[dict[str, Quantity], dict[str, Quantity]]:
    """What follows from the derivatives, before and after; a delay of the model itself stands there
    as well.
    """
    pairs = ((d.derived_before, d.before), (d.derived_after, d.after))
    before, after = (
        {**derived, **({"delay": own["delay"]} if "delay" in own else {})} for derived, own in pairs
    )
    return before, after


def derived_rows(d: Diagnosis) -> list[tuple[str, ...]]:
    """Rows of what follows from the derivatives; a frequency in rad/s and once more in Hz."""
    rows: list[tuple[str, ...]] = []
    before, after = derived_of(d)
    for name in (name for name in before if name in after):
        words = name.replace("_", " ")
        rows += derivative_rows({words: before[name]}, {words: after[name]})
        if is_frequency(name, before[name].unit):
            rows += derivative_rows({words: _hertz(before[name])}, {words: _hertz(after[name])})
    return rows


def _hertz(q: Quantity) -> Quantity:
    return Quantity(q.value / (2.0 * math.pi), q.std / (2.0 * math.pi), "Hz")


def sigma_note(d: Diagnosis) -> str:
    """That sigmas are widened, where they are; the scatter is that of fits with the effects, and
    nothing to say where none stands.
    """
    return SIGMA_NOTE if d.inflation and not nothing_stands(d) else ""


def moved_title(d: Diagnosis) -> str:
    """Heading of the table of derivatives."""
    if nothing_stands(d):
        return (
            "derivatives of the declared model: something is missing in it, they carry what it "
            "costs"
        )
    any_moved = any(
        abs(moved(d.before[name], d.after[name])) > MOVED for name in d.before if name in d.after
    )
    return (
        "derivatives (* moved by more than two sigmas of both together)"
        if any_moved
        else "derivatives"
    )


def moved(old: Quantity, new: Quantity) -> float:
    """The change in standard deviations of both together; zero where neither is known."""
    spread = math.hypot(old.std, new.std)
    return (new.value - old.value) / spread if spread > 0 and math.isfinite(spread) else 0.0


def short(value: float) -> str:
    """Three digits, no exponent below ten millions; a dash where there is no number."""
    return (
        "-"
        if not math.isfinite(value)
        else f"{value:.3g}"
        if value < 1e4
        else f"{value:.0f}"
        if value < 1e7
        else f"{value:.2g}"
    )
