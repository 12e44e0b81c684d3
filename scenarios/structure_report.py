"""A structure that was found, in lines, as a page, and in a folder."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.structure.averaging import HIGH_INDEX, HIGH_INFLATION
from ident.structure.products import columns_of
from ident.structure.selection import F_IN, ORTHOGONAL, STEPWISE, Selection
from scenarios.files.aircraft_files import vehicle_file_text
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.preparation.reading import separate_controls
from scenarios.report.document import (
    PURE,
    Bullets,
    Cell,
    Column,
    Page,
    Prose,
    Table,
    estimate,
    formatted,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures as page_figures
from scenarios.report.folder import write_page
from scenarios.report.quantities import shown_in, spaced
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines, wrapped
from scenarios.report.terminal import rows_table, table_as_lines
from scenarios.structure import FoundStructure
from sim.aerodynamics import Term

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.plots.drawing import Named

METHOD_WORDS = {STEPWISE: "stepwise regression", ORTHOGONAL: "orthogonal functions"}
MAIN = "structure.json"
SCHEMA = "flightid/structure/1"
VEHICLE = "vehicle.toml"
COLLINEAR_CORRELATION = 0.98  # correlation of two surfaces: a variance inflation of 25


def structure_text(found: FoundStructure, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the results for the terminal; ``details`` says where the rest is kept."""
    lines = [*summary_lines(structure_summary(found, details), width), ""]
    lines += wrapped(
        f"bandwidth of angular accelerations {found.histories[0].bandwidth:.2g} Hz; "
        f"{_method(found)}",
        width,
    )
    lines += table_as_lines(summary_table(found), width, keys=1)
    if found.predicted:
        lines += ["", *table_as_lines(prediction_table(found), width, keys=1)]
    for axis in found.selections:
        lines += ["", *table_as_lines(terms_table(found, axis), width, keys=1)]
    for sentence in (*findings(found), *(f"note: {each}" for each in found.notes)):
        lines += wrapped(sentence, width)
    return "\n".join(lines) + "\n"


def structure_summary(found: FoundStructure, details: str = BELOW) -> Summary:
    """Return the summary: records, number of chosen terms, lowest R2, residual over the noise."""
    names = ", ".join(each.name for each in found.histories)
    windows = sum(len(each.time) for each in found.histories)
    some = found.selections
    lacking = [axis for axis, each in some.items() if each.lacking]
    worst = min(some.values(), key=lambda each: each.r2)
    result = f"lowest R2 {worst.r2:.4f} ({worst.axis})"
    held = [(r2, axis) for told in found.predicted.values() for axis, r2 in told.items()]
    if held:
        result += "; on records that were not fitted {:.4f} ({})".format(*min(held))
    ratios = [each.ratio for each in some.values()]
    return Summary(
        f"{names}: {windows} windows; {found.aircraft.name}",
        f"terms are missing in {', '.join(lacking)}"
        if lacking
        else f"terms found: {', '.join(f'{axis} {len(e.terms)}' for axis, e in some.items())}",
        result,
        f"{min(ratios):.2f} to {max(ratios):.2f} times the noise",
        details,
    )


def _method(found: FoundStructure) -> str:
    hierarchical = ", hierarchical" if found.options.hierarchical else ""
    return METHOD_WORDS[found.options.method] + hierarchical


def summary_table(found: FoundStructure) -> Table:
    """Return a table that shows how well each coefficient is described."""
    rows: list[list[Cell]] = []
    for axis, each in found.selections.items():
        rows.append(
            [
                axis,
                formatted(float(len(each.terms)), ".0f", PURE),
                formatted(each.r2, ".4f", PURE),
                *_held(each.held_out, found),
                formatted(each.ratio, ".2f", PURE),
            ]
        )
    columns = (
        Column("coefficient"),
        Column("terms"),
        Column("R2"),
        *((Column("R2 left out"),) if _several(found) else ()),
        Column("residual/noise"),
    )
    return rows_table("R2, and residual over noise", columns, rows)


def prediction_table(found: FoundStructure) -> Table:
    """Return a table of R2 of each coefficient on records that were not fitted."""
    rows: list[list[Cell]] = [
        [name, *(formatted(value, ".4f", PURE) for value in told.values())]
        for name, told in found.predicted.items()
    ]
    columns = (Column("not fitted"), *(Column(f"R2 {axis}") for axis in found.selections))
    return rows_table("records that were not fitted", columns, rows)


def _f_digits(ratios: Iterable[float]) -> str:
    """Return the number format of a column of F ratios, so that 2.41e+04 is not beside 350."""
    finite = [abs(float(F)) for F in ratios if math.isfinite(float(F))]
    return ".0f" if max(finite, default=0.0) >= 1000.0 else ".3g"


def terms_table(found: FoundStructure, axis: str) -> Table:
    """Return a table of a coefficient's terms: values, partial F ratios given all other terms, R2
    and predicted squared error (PSE) after the step that added the term, variance inflation (VIF).
    """
    each, together = found.selections[axis], found.collinearity[axis]
    inflation = dict(zip(together.terms, together.inflation.tolist(), strict=True))
    steps = {step.term: step for step in each.steps if step.added}
    rows: list[list[Cell]] = []
    digits = _f_digits(each.ratios)
    numbers = (each.terms, each.values, each.sigma, each.ratios)
    for term, value, sigma, F in zip(*numbers, strict=True):
        step = steps.get(term)
        rows.append(
            [
                "constant" if not term.factors else term.text,
                estimate(float(value), float(sigma)),
                formatted(float(F), digits, PURE) if term.factors else "",
                formatted(step.r2, ".4f", PURE) if step else "",
                *_held(step.held_out if step else math.nan, found),
                formatted(step.pse, ".3g", PURE) if step else "",
                formatted(inflation[term], ".1f", PURE) if term in inflation else "",
            ]
        )
    left = ("R2 left out",) if _several(found) else ()
    columns = [Column("term", code=True), Column("estimate ± σ", PURE, printed="estimate")]
    columns += [Column(head) for head in ("F", "R2", *left, "PSE", "VIF")]
    return rows_table(axis, columns, rows)


TERMS_NOTE = (
    "angles and deflections in rad; p, q and r are p b/(2V), q c/(2V) and r b/(2V). F: test of a "
    "term given all others. R2 and PSE (predicted squared error): after the step that added the "
    "term. VIF: variance inflation by the other terms"
)


def _several(found: FoundStructure) -> bool:
    """Return whether there are maneuvers of which one can be left out."""
    return len(found.histories) > 1


def _held(value: float, found: FoundStructure) -> tuple[Cell, ...]:
    """Return the cell of R2 on maneuvers left out; no cell if there is only one maneuver."""
    if not _several(found):
        return ()
    return (formatted(value, ".4f", PURE) if math.isfinite(value) else "",)


def findings(found: FoundStructure) -> list[str]:
    """Return sentences on missing and collinear terms, and on differences of the methods."""
    sentences = _surfaces_together(found)
    for axis, each in found.selections.items():
        if each.lacking:
            term, F, share = each.lacking[0]
            sentences.append(
                f"{axis} lacks terms: its residual is {each.ratio:.1f} times the noise, and "
                f"{term.text}, which was not offered, explains {100 * share:.0f} % of it "
                f"(F {F:.3g})."
            )
        elif each.r2 < 0.9 and each.ratio > 3.0:
            sentences.append(
                f"{axis}: the terms explain {100 * each.r2:.0f} % of the variance, and the "
                f"residual is {each.ratio:.1f} times the noise. Offer further terms (--degree 3, "
                "--splines)."
            )
        other = set(found.other[axis].terms)
        used = METHOD_WORDS[found.options.method]
        methods = (used, next(words for words in METHOD_WORDS.values() if words != used))
        alone = (set(each.terms) - other, other - set(each.terms))
        sentences += [
            f"{axis}: {method} alone chose {', '.join(sorted(term.text for term in terms))}."
            for method, terms in zip(methods, alone, strict=True)
            if terms
        ]
        if each.alternative:
            sentences.append(f"{axis}: {_other_model(*each.alternative)}")
        if each.confounders:
            names = ", ".join(term.text for term in each.confounders)
            verb = "is" if len(each.confounders) == 1 else "are"
            sentences.append(
                f"{axis}: {names} {verb} weak (F below {F_IN:g} for coloured residuals). The model "
                f"keeps {(them := 'it' if verb == 'is' else 'them')}, because the values of other "
                f"terms depend on {them}."
            )
    for axis, together in found.collinearity.items():
        index = float(together.indices[0]) if len(together.indices) else 1.0
        high = [t.text for t, v in zip(together.terms, together.inflation, strict=True) if v > 10]
        if together.advice or high:
            names = f", variance inflation above {HIGH_INFLATION:g}: {', '.join(high)}"
            sentences.append(
                f"{axis}: condition index {index:.0f} (limit {HIGH_INDEX:g})"
                f"{names if high else ''}."
            )
            sentences += [f"To separate {advice}." for advice in together.advice]
    return list(dict.fromkeys([*sentences, *_still_signals(found)]))


def _still_signals(found: FoundStructure) -> list[str]:
    """Return the sentences on signals that hardly move while those of chosen terms do."""
    names: dict[str, dict[str, None]] = {}
    for axis, each in found.collinearity.items():
        for base, product in each.multiples:
            for still in product.signals - base.signals:
                names.setdefault(still, {})[f"{axis} {base.text}"] = None
    sentences = []
    for still, terms in names.items():
        mean = np.mean(np.concatenate([each.samples[still] for each in found.histories]))
        factor, unit = shown_in("rad", still) if still in ("alpha", "beta") else (1.0, "")
        sentences.append(
            f"{still} stays near {factor * mean:.3g}{spaced(unit)} while these terms move: "
            f"{', '.join(terms)}. Their values hold there, and not where {still} is zero. Records "
            f"at other values of {still} would tell them from products with {still}."
        )
    return sentences


def _other_model(added: Term | None, removed: Term | None, probability: float) -> str:
    """Return the sentences on another model that explains the data as well."""
    if added is None and removed is not None:
        what = f"a model without {removed.text}"
    elif removed is None and added is not None:
        what = f"a model that also has {added.text}"
    else:
        assert added is not None and removed is not None
        what = f"a model with {added.text} in the place of {removed.text}"
    return (
        f"{what} explains the data nearly as well (probability {100 * probability:.0f} %). The "
        "standard deviations include this, those of identify do not. More maneuvers would decide."
    )


def _surfaces_together(found: FoundStructure) -> list[str]:
    """Return the sentences on surfaces that move together in all records."""
    rows = {}
    for name in separate_controls(found.aircraft):
        parts = [h.samples[name] - np.mean(h.samples[name]) for h in found.histories]
        row = np.concatenate(parts)
        if np.any(row):
            rows[name] = row / np.sqrt(row @ row)
    return [
        f"{one} and {other} move together (correlation {float(rows[one] @ rows[other]):.3f}). "
        "Their effects cannot be separated. Move one after the other."
        for one, other in combinations(rows, 2)
        if abs(float(rows[one] @ rows[other])) > COLLINEAR_CORRELATION
    ]


# ---- Figures


def structure_figures(found: FoundStructure) -> Iterator[Named]:
    """Yield figures of measured and modelled coefficients: one of forces and one of moments."""
    axes = list(found.selections)
    for stem, part in (("forces", axes[:3]), ("moments", axes[3:])):
        yield stem, partial(coefficient_figure, found, part)


def modelled(found: FoundStructure, axis: str, number: int) -> np.ndarray:
    """Return a coefficient of a maneuver by the terms found, ``(M,)``."""
    each = found.selections[axis]
    return np.asarray(columns_of(found.histories[number], each.terms, axis) @ each.values)


def coefficient_figure(found: FoundStructure, axes: Sequence[str], most: int = 4) -> Figure:
    """Plot measured and modelled coefficients over time, the first maneuvers side by side.

    Parameters
    ----------
    axes : coefficients, a row each.
    most : maneuvers shown at most.
    """
    from scenarios.plots.style import (
        BLUE,
        MEASURED,
        caption,
        finish,
        make_sheet,
        time_axis,
        y_label,
    )

    shown = found.histories[:most]
    sheet = make_sheet([1.5] * len(axes), [1.0] * len(shown))
    for row, axis in enumerate(axes):
        for number, history in enumerate(shown):
            panel = sheet.axes[row][number]
            panel.plot(history.time, history.coefficients[axis], **MEASURED, label="measured")
            panel.plot(
                history.time, modelled(found, axis, number), color=BLUE, lw=1.2, label="modelled"
            )
            if number == 0:
                y_label(panel, axis)
            if row == 0 and len(shown) > 1:
                caption(panel, history.name)
            if row == len(axes) - 1:
                time_axis(panel)
    title = "Coefficients, measured and modelled"
    if len(shown) < len(found.histories):
        title += f"\nthe first {len(shown)} of {len(found.histories)} records"
    return finish(sheet, title, head=0.3 if len(shown) > 1 else 0.08)


# ---- Page and folder


def structure_page(found: FoundStructure, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a structure."""
    worst = min(found.selections.values(), key=lambda each: each.r2)
    lacking = [axis for axis, each in found.selections.items() if each.lacking]
    inputs = [
        ("vehicle" if each is found.files[-1] else "record", each.name, each.sha256)
        for each in found.files
    ]
    fitted = {each.name for each in found.histories}
    records = [each.name for each in found.files[:-1]]
    sentences = ["flightid", "structure", *(name for name in records if name in fitted)]
    held = [name for name in records if name not in fitted]
    sentences += ["--vehicle", found.files[-1].name, *(["--validate", *held] if held else [])]
    return Page(
        title=f"{found.aircraft.name}: model structure",
        kind=f"Terms of six coefficients by {_method(found)}",
        verdict=f"terms are missing in {', '.join(lacking)}" if lacking else "terms found",
        tone="open" if lacking else "plain",
        sentence=f"The lowest R2 is that of {worst.axis}: {worst.r2:.3f}.",
        summary=(),
        warnings=(),
        sections=(
            *section("Figures", *page_figures(drawn)),
            *section("Coefficients", summary_table(found)),
            *(section("Not fitted", prediction_table(found)) if found.predicted else ()),
            *section("Findings", Bullets(tuple(findings(found)))),
            *section(
                "Terms",
                *(terms_table(found, axis) for axis in found.selections),
                Prose(TERMS_NOTE, "note"),
            ),
            *section("How it was made", Bullets(found.notes)),
        ),
        reproduction=reproduction(sentences, "", inputs),
        created=now(),
    )


def write_structure(found: FoundStructure, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write ``vehicle.toml`` for `identify`, figures, the page, and ``structure.json`` last.

    Returns
    -------
    The folder.
    """
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / VEHICLE, vehicle_file_text(found.aircraft, found.sigmas))
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import draw_for_page

            drawn = draw_for_page(structure_figures(found), scratch, figures)
        write_page(scratch, structure_page(found, drawn))
        write_json(scratch / MAIN, structure_content(found))
    return Path(folder)


def structure_content(found: FoundStructure) -> dict[str, Any]:
    """Return the content of ``structure.json``."""
    return {
        "schema": SCHEMA,
        "vehicle": found.aircraft.name,
        "method": found.options.method,
        "baseline": found.options.baseline,
        "hierarchical": found.options.hierarchical,
        "bandwidth": found.histories[0].bandwidth,
        "maneuvers": [{"name": each.name, "windows": len(each.time)} for each in found.histories],
        "coefficients": {
            axis: {
                **_selection(each),
                "other_method": _selection(found.other[axis]),
                "condition_indices": found.collinearity[axis].indices.tolist(),
                "correlations": [
                    [a.text, b.text, value] for a, b, value in found.collinearity[axis].correlations
                ],
                "advice": list(found.collinearity[axis].advice),
            }
            for axis, each in found.selections.items()
        },
        "r2_not_fitted": {name: dict(told) for name, told in found.predicted.items()},
        "findings": findings(found),
        "notes": list(found.notes),
        "inputs": [{"name": each.name, "sha256": each.sha256} for each in found.files],
        "versions": versions(),
    }


def _selection(each: Selection) -> Mapping[str, Any]:
    return {
        "method": each.method,
        "terms": {
            term.text: {"value": float(value), "std": float(sigma)}
            for term, value, sigma in zip(each.terms, each.values, each.sigma, strict=True)
        },
        "r2": each.r2,
        **_left_out(each.held_out),
        "residual_rms": each.rms,
        "noise_rms": each.noise,
        "steps": [
            {
                "term": step.term.text,
                "added": step.added,
                "F": step.F,
                "r2": step.r2,
                "pse": step.pse,
                **_left_out(step.held_out),
            }
            for step in each.steps
        ],
        "lacking": [{"term": term.text, "F": F, "share": share} for term, F, share in each.lacking],
    }


def _left_out(r2: float) -> dict[str, float]:
    """Return R2 on maneuvers left out; empty if there is only one maneuver."""
    return {"r2_left_out": r2} if math.isfinite(r2) else {}
