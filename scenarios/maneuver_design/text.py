"""A design in lines for the terminal: five of summary, then the table of the maneuvers and what they rest on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.maneuver_design.rivalry import Acting
from scenarios.files.user_models import unit_in
from scenarios.maneuver_design.design import Design, Maneuver
from scenarios.maneuver_design.kinds import PACE_IS
from scenarios.terminal.quantities import number_text, shown_in, spaced
from scenarios.terminal.summary import BELOW, Summary, summary_lines
from scenarios.terminal.tables import WIDTH, columns_of, table_lines, wrapped

SHOWN = ("nz", "alpha", "q", "beta", "p", "r", "phi", "ny", "airspeed")  # outputs whose extremes stand in the table, those that the model has
LEAST = 0.05  # chance, below which no maneuver is said to decide


def design_text(design: Design, width: int = WIDTH, details: str = BELOW) -> str:
    """What a terminal of this width shows."""
    lines = [*summary_lines(summary_of(design, details), width), ""]
    lines += table_lines(columns_of(*comparison(design), left=1, words=("held by",)), title=_title(design), width=width)
    if design.acting:
        lines += [
            "",
            *table_lines(columns_of(*contest_table(design), left=2), title=f"{design.best.kind}: who would be told from whom", width=width, keys=2),
        ]
    lines += ["", *table_lines(columns_of(*sigma_table(design), left=2), title="expected standard deviations (Cramer-Rao)", width=width, keys=2)]
    if design.best.responses is not None:
        title = "frequency responses expected of one flight, share of the band with a coherence of 0.6 or more, and random error"
        lines += ["", *table_lines(columns_of(*response_table(design), left=1), title=title, width=width)]
    for note in notes_of(design):
        lines += wrapped(note, width)
    lines += wrapped(f"again: {design.asked.command()}", width)
    return "\n".join(lines) + "\n"


def summary_of(design: Design, details: str = BELOW) -> Summary:
    """Vehicle and limits; the best maneuver; what it tells and how far it goes."""
    setting, best = design.setting, design.best
    seconds = setting.room.time[-1]
    study = f"{setting.vehicle.name}, {setting.model.name} model: {len(design.maneuvers)} kinds of maneuver, {seconds:g} s at {setting.rate:g} Hz"
    return Summary(study, verdict_of(design), f"{_tells(design)}; peaks {extremes_text(design, best)}", details=details)


def verdict_of(design: Design) -> str:
    """The best maneuver in a sentence."""
    best, names = design.best, " or ".join(each.effect.name for each in design.acting)
    if not names:
        return f"FLY: {maneuver_text(design, best)}"
    if best.chance < LEAST:
        return f"NONE DECIDES: within these limits no maneuver tells {names}"
    return f"FLY: {maneuver_text(design, best)} tells {names} with a chance of {percent(best.chance)}"


def maneuver_text(design: Design, maneuver: Maneuver) -> str:
    """``"3-2-1-1 (step 0.48 s), elevator 3.2 deg"``."""
    peaks = [f"{name} {_shown(design, name, value)}" for name, value in peaks_of(design, maneuver).items()]
    return f"{maneuver.kind} ({pace_text(maneuver)}), {', '.join(peaks)}"


def pace_text(maneuver: Maneuver) -> str:
    """The step of steps, the highest frequency of the others."""
    if PACE_IS[maneuver.kind] == "step":
        return f"step {maneuver.pace:.3g} s"
    return f"up to {0.5 / maneuver.pace:.3g} Hz"


def peaks_of(design: Design, maneuver: Maneuver) -> dict[str, float]:
    """Largest deflection from rest by input."""
    return {name: float(np.max(np.abs(row))) for name, row in zip(design.setting.rest, maneuver.flight.rows, strict=True)}


def comparison(design: Design) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of the maneuvers, the best first."""
    setting, told = design.setting, bool(design.acting)
    outputs = [name for name in SHOWN if name in setting.noise] or list(setting.noise)[:3]
    headings = ("maneuver", "pace", *(f"peak {name}" for name in setting.rest), "mean sigma %")
    headings += ("log likelihood", "chance %") if told else ()
    headings += (*(f"{name} from .. to" for name in outputs), "held by")
    rows = []
    for each in design.maneuvers:
        row = [each.kind, pace_text(each), *(_shown(design, name, value) for name, value in peaks_of(design, each).items())]
        row += [f"{100.0 * each.criterion:.3g}"]
        row += [f"{each.log_likelihood:.1f}", f"{100.0 * each.chance:.0f}"] if told else []
        row += [_range(design, each, name) for name in outputs]
        rows.append((*row, each.flight.bound_by or "amplitude"))
    return headings, rows


def contest_table(design: Design) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of what each effect's flight says against the other, of the best maneuver."""
    headings = ("acts", "is told from", "gain over none", "log likelihood", "sigma", "told %", "wrong %")
    rows: list[tuple[str, ...]] = []
    for each in design.best.contests:
        d = each.decision
        cells = (f"{each.found:.1f}", f"{d.log_likelihood:.1f}", f"{0.5 * d.std:.1f}", f"{100.0 * each.chance:.1f}", f"{100.0 * d.wrong:.2g}")
        rows.append((acting_text(each.true), each.rival.effect.name, *cells))
    return headings, rows


def sigma_table(design: Design) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of expected standard deviations by parameter and maneuver."""
    parameters = design.setting.model.parameters
    headings = ("parameter", "unit", "value", *(each.kind for each in design.maneuvers))
    rows = []
    for name in design.best.sigmas:
        sigmas = [each.sigmas[name] for each in design.maneuvers]
        told = [f"{std:.2g}" if std < 1e3 * max(abs(parameters[name].value), 1e-3) else "not determined" for std in sigmas]
        rows.append((name, parameters[name].unit, number_text(parameters[name].value), *told))
    return headings, rows


def response_table(design: Design) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of what each maneuver would give of every response over the band."""
    kinds = [(each.kind, each.responses) for each in design.maneuvers if each.responses is not None]
    headings = ["response"]
    for kind, _ in kinds:
        headings += [f"{kind}: usable %", "coherence, least", "random error, median %"]
    rows = []
    first = kinds[0][1]
    for m, output in enumerate(first.outputs):
        for q, name in enumerate(first.inputs):
            cells = [f"{output}/{name}"]
            for _, found in kinds:
                error = 100.0 * float(np.median(found.random_error[m, q]))
                shown = f"{error:.2g}" if error < 100.0 else "above 100"
                cells += [f"{100.0 * found.usable[m, q]:.0f}", f"{found.coherence[m, q].min():.2f}", shown]
            rows.append(tuple(cells))
    return tuple(headings), rows


def notes_of(design: Design) -> list[str]:
    """What the design rests on: noise, limits, trim, sizes."""
    setting = design.setting
    noise = [f"{name} {_shown(design, name, value)}" for name, value in setting.noise.items()]
    limits = [f"{name} {_ends(design, name, ends)}" for name, ends in setting.limits.outputs.items()]
    limits += [f"{name} {_shown(design, name, value)}" for name, value in setting.limits.amplitude.items()]
    limits += [f"{name} {_shown(design, name, value)} a second" for name, value in setting.limits.rate.items()]
    notes = [f"noise (1 sigma): {', '.join(noise)}", f"limits: {', '.join(limits)}; load factors are totals, 1 in level flight"]
    trim = [f"{name} {_shown(design, name, value)}" for name, value in setting.rest.items() if value]
    return notes + ([f"trim: {', '.join(trim)}"] if trim else [])


def acting_text(acting: Acting) -> str:
    """An effect with its values."""
    units = {item.name: item.unit for item in acting.effect.parameters}
    told = []
    for name, value in acting.values.items():
        factor, unit = shown_in(units.get(name, "1"), name)
        told.append(f"{name} {factor * value:.3g}{spaced(unit)}")
    return f"{acting.effect.name} ({', '.join(told)})"


def percent(chance: float) -> str:
    """A probability in per cent; none is said to be sure."""
    return "more than 99 %" if chance > 0.995 else f"{100.0 * chance:.0f} %"


def extremes_text(design: Design, maneuver: Maneuver) -> str:
    """Extremes of all outputs in one line."""
    return ", ".join(f"{name} {_range(design, maneuver, name)}" for name in maneuver.flight.extremes)


def _title(design: Design) -> str:
    if design.best.responses is not None:
        return "maneuvers over the band within the limits, the one with the least random errors first"
    told = "; log likelihood and chance are the least over who acts" if design.acting else ""
    return f"maneuvers at equal amplitude and time, within the limits, the best first; mean sigma: geometric mean over the values{told}"


def _tells(design: Design) -> str:
    best = design.best
    if best.responses is not None:
        share = 100.0 * float(np.mean(best.responses.usable))
        low, high = best.responses.frequency[[0, -1]]
        error = 100.0 * best.responses.criterion
        return f"responses from {low:.3g} to {high:.3g} Hz usable in {share:.0f} % of the band, mean random error {error:.2g} %"
    if not design.acting:
        return f"expected sigmas {100.0 * best.criterion:.3g} % of the derivatives (geometric mean)"
    return f"expected log likelihood {best.log_likelihood:.1f}; {'; '.join(acting_text(each) for each in design.acting)}"


def _range(design: Design, maneuver: Maneuver, name: str) -> str:
    low, high = maneuver.flight.extremes[name]
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{factor * low:.3g} .. {factor * high:.3g}{spaced(unit)}"


def _ends(design: Design, name: str, ends: tuple[float, float]) -> str:
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{factor * ends[0]:.3g} to {factor * ends[1]:.3g}{spaced(unit)}"


def _shown(design: Design, name: str, value: float) -> str:
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{factor * value:.3g}{spaced(unit)}"


def units_shown(design: Design) -> Mapping[str, str]:
    """Unit inside of every channel."""
    return {name: unit_in(design.setting.model, name) for name in (*design.setting.rest, *design.setting.noise)}
