"""Why sigmas are wrong, in words, for the terminal and the page."""

from __future__ import annotations

import math
from collections.abc import Callable

from rich.console import Console

from scenarios.studies.campaign_causes.findings import COLOUR, MODEL, NOISE, OPEN, PRIOR, Finding, Findings
from scenarios.studies.campaign_causes.levels import PARAMETERS, STATES, Level
from scenarios.studies.campaign_causes.trials import FURTHER, LEVELS, START, STEPS
from scenarios.studies.campaign_statistics.statistics import NORMAL
from scenarios.terminal.display_units import shown_in
from scenarios.terminal.numbers import number
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.tables import Column, print_table

TITLE = "wrong sigmas, why, and right ones beside them"
LEVELS_TITLE = "noise levels by likelihood beside those that are assumed"

# Of each cause a word for tables, and what there is to say of it.
_WORDS = {
    START: "far start",
    STEPS: "steps",
    LEVELS: "noise levels",
    PRIOR: "prior",
    COLOUR: "coloured noise",
    NOISE: "size of the noise",
    MODEL: "model",
    OPEN: "not found",
}


def cause_word(finding: Finding) -> str:
    """The causes in a word or two each."""
    return " + ".join(_WORDS[each] for each in finding.causes)


def print_findings(found: Findings, out: Console) -> None:
    """Noise levels where they were looked for; a row and a sentence for each wrong sigma."""
    if found.levels is not None:
        out.print()
        print_levels(found, out)
    if not found.found:
        return
    each = found.found
    shown = [shown_in(f.wrong.statistics.unit, f.name) for f in each]
    columns = [
        Column("parameter", [f.name for f in each], left=True),
        Column("sigma is", [direction(f) for f in each], left=True),
        Column("reported", [_two(factor * f.wrong.statistics.reported) for f, (factor, _) in zip(each, shown, strict=True)]),
        Column("right one", [_two(factor * f.corrected) for f, (factor, _) in zip(each, shown, strict=True)]),
        Column("its coverage", [coverage_text(f) for f in each]),
        Column("because of", [cause_word(f) for f in each], left=True),
    ]
    out.print()
    print_table(out, TITLE, columns)
    for sentence in cause_sentences(found):
        print_paragraph(out, sentence, 0)


def print_levels(found: Findings, out: Console) -> None:
    """A row a level, and whether all are as assumed."""
    items = found.levels.items if found.levels is not None else ()
    columns = [
        Column("noise of", [item.name for item in items], left=True),
        Column("unit", [shown_in(item.unit, item.name)[1] for item in items], left=True),
        Column("assumed", [level_text(item, item.assumed) for item in items]),
        Column("by likelihood", [level_text(item, item.found) for item in items]),
        Column("agree", ["yes" if item.agrees else "no" for item in items], left=True),
    ]
    print_table(out, LEVELS_TITLE, columns)
    print_paragraph(out, levels_sentence(found), 0)


def level_text(item: Level, value: float) -> str:
    """A level in the unit in which it is shown; of process noise as a factor on the declared deviations."""
    if value == 0.0:
        return "none"
    if item.name in (STATES, PARAMETERS):
        return "as declared" if value == 1.0 else f"{value:.2g} times" if item.assumed else "some"
    return f"{shown_in(item.unit, item.name)[0] * value:.4g}"


def levels_sentence(found: Findings) -> str:
    """Whether the levels that are assumed are those under which the records are most probable; nothing where these were not looked for."""
    levels = found.levels
    if levels is None:
        return ""
    off = [item for item in levels.items if not item.agrees]
    over = f"over {levels.runs} runs"
    if not off:
        return f"noise levels by likelihood {over} agree with those that are assumed"
    said = f"noise levels by likelihood {over} disagree with those that are assumed: {'; '.join(_off(item) for item in off)}"
    forced = any(item.name in (STATES, PARAMETERS) and item.found > 0.0 for item in off)
    return f"{said}; that process noise stands for what the model cannot follow" if forced and found.misfits else said


def _off(item: Level) -> str:
    if item.name not in (STATES, PARAMETERS):
        return f"noise of {item.name} {item.found / item.assumed:.2f} times the assumed standard deviation"
    if item.assumed == 0.0:
        return f"{item.name}, of which none is assumed, acts"
    return f"{item.name}: none acts" if item.found == 0.0 else f"{item.name} {item.found:.2g} times the assumed standard deviation"


def direction(finding: Finding) -> str:
    """``"too small by 3.2"``: the factor that makes two sigmas hold 95.4 % of the errors."""
    factor = finding.wrong.factor
    return f"too small by {_factor(factor)}" if factor > 1.0 else f"too large by {_factor(1.0 / max(factor, 1e-12))}"


def coverage_text(finding: Finding) -> str:
    """Share within two right sigmas, with its interval."""
    within = finding.coverage
    return f"{100 * within.share:.1f} % ({100 * within.interval[0]:.1f} to {100 * within.interval[1]:.1f})"


def cause_sentences(found: Findings) -> list[str]:
    """For each set of causes the parameters it concerns, what it is, and how that was told."""
    groups: dict[tuple[tuple[str, ...], bool], list[Finding]] = {}
    for each in found.found:
        groups.setdefault((each.causes, each.again), []).append(each)
    said = {key: "; and ".join(_SAID[cause](group, found) for cause in key[0]) for key, group in groups.items()}
    return [f"{_directions(group)}: {said[key]}{_how(group, found)}" for key, group in groups.items()]


def _directions(group: list[Finding]) -> str:
    """By what the sigmas of a group are wrong."""
    parts = []
    for small, word in ((True, "too small"), (False, "too large")):
        factors = sorted(f.wrong.factor if small else 1.0 / max(f.wrong.factor, 1e-12) for f in group if f.wrong.too_small is small)
        if factors:
            ends = _factor(factors[0]) if _factor(factors[0]) == _factor(factors[-1]) else f"{_factor(factors[0])} to {_factor(factors[-1])}"
            parts.append(f"{word} by {ends}")
    return f"{'sigmas' if len(group) > 1 else 'sigma'} of {_names(group)} {' and '.join(parts)}"


def _how(group: list[Finding], found: Findings) -> str:
    """From where the right sigma comes."""
    if group[0].again:
        return f". With that changed, {found.again} of the runs computed again have the right sigma above"
    if group[0].causes[-1] in (MODEL, NOISE, OPEN):
        return ". The right sigma is of half the runs, its coverage of the other half"
    return ". The right sigma follows from that alone, its coverage is that of all runs"


def _start(group: list[Finding], found: Findings) -> str:
    return f"the estimator starts too far off and linearises there: started again from its own result, {FURTHER} passes more, it is right"


def _steps(group: list[Finding], found: Findings) -> str:
    return "its integration is too coarse and moves the estimates: with fourth-order steps of a quarter of a sample they are not moved"


def _levels(group: list[Finding], found: Findings) -> str:
    return f"it assumes wrong noise ({_what_is_off(found)}): with the levels by likelihood it is right"


def _what_is_off(found: Findings) -> str:
    items = found.levels.items if found.levels is not None else ()
    return "; ".join(_off(item) for item in items if not item.agrees)


def _prior(group: list[Finding], found: Findings) -> str:
    if math.isnan(group[0].strength):
        return "estimates lean on the prior and scatter less than stated: started again from their own result, where it counts no more, they do"
    shares = [100 * each.strength for each in group]
    share = f"{min(shares):.0f} %" if max(shares) - min(shares) < 1.0 else f"{min(shares):.0f} to {max(shares):.0f} %"
    return f"the prior gives {share} of the stated variance; the runs share its wrong mean, about which estimates neither scatter nor centre"


def _colour(group: list[Finding], found: Findings) -> str:
    return f"the noise is not white, neighbouring samples correlate by {group[0].strength:.2f} and tell less than the filter counts"


def _noise(group: list[Finding], found: Findings) -> str:
    return "the noise itself biases the estimate (it stands in what is not linear, or in regressors): with a tenth of it the bias goes"


def _model(group: list[Finding], found: Findings) -> str:
    share = max(each.wrong.mean**2 / each.wrong.rms**2 for each in group)
    said = f"bias makes up to {100 * share:.0f} % of the mean square error"
    if not any(each.wrong.too_small for each in group):
        said += "; what is declared in its place, process noise, is more than it needs"
    left = f"at the reference values it leaves {group[0].strength:.2g} times the noise, the same in all runs"
    return f"the model cannot follow the flight: {left}; {said}"


def _open(group: list[Finding], found: Findings) -> str:
    share = max(each.wrong.mean**2 / each.wrong.rms**2 for each in group)
    said = f"bias makes up to {100 * share:.0f} % of the mean square error"
    return f"no cause was found: the model follows the flight, and nothing that was changed makes it right; {said}"


_SAID: dict[str, Callable[[list[Finding], Findings], str]] = {
    START: _start,
    STEPS: _steps,
    LEVELS: _levels,
    PRIOR: _prior,
    COLOUR: _colour,
    NOISE: _noise,
    MODEL: _model,
    OPEN: _open,
}


def _names(group: list[Finding]) -> str:
    names = [each.name for each in group]
    few = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    return f"{few} ({100 * group[0].wrong.statistics.two.share:.1f} % within two sigmas, not {100 * NORMAL[2]:.1f} %)" if len(names) == 1 else few


def _factor(value: float) -> str:
    return f"{value:.2f}" if value < 10.0 else f"{value:.0f}"


def _two(value: float) -> str:
    return number(value, value)
