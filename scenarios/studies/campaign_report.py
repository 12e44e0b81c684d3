"""A campaign in the terminal, on its page and in its folder, with the causes of wrong sigmas."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json
from scenarios.pages.folder import figures, write_page
from scenarios.pages.model import (
    BY_ROW,
    PURE,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.plots.formats import USUAL, Drawn, Formats
from scenarios.studies.campaign import CampaignRuns, Spread
from scenarios.studies.campaign_causes import (
    COLOUR,
    MODEL,
    NOISE,
    OPEN,
    PRIOR,
    Finding,
    Findings,
    Judgement,
)
from scenarios.studies.campaign_statistics import (
    NORMAL,
    print_statistics,
    statistics_blocks,
    statistics_content,
    statistics_csv,
)
from scenarios.studies.campaign_trials import (
    FURTHER,
    LEVELS,
    PARAMETERS,
    START,
    STATES,
    TRIALS_STEPS,
    Level,
    Levels,
)
from scenarios.terminal.quantities import console, number_text, shown_in, unit_cell
from scenarios.terminal.summary import BELOW, Summary, print_summary
from scenarios.terminal.tables import TableColumn, print_paragraph, print_table

# ---- Why sigmas are wrong, in words, for the terminal and the page

TITLE = "wrong sigmas, why, and right ones beside them"
LEVELS_TITLE = "noise levels by likelihood beside those that are assumed"

# Of each cause a word for tables, and what there is to say of it.
_WORDS = {
    START: "far start",
    TRIALS_STEPS: "steps",
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
        TableColumn("parameter", [f.name for f in each], left=True),
        TableColumn("sigma is", [direction(f) for f in each], left=True),
        TableColumn(
            "reported",
            [
                _two(factor * f.wrong.statistics.reported)
                for f, (factor, _) in zip(each, shown, strict=True)
            ],
        ),
        TableColumn(
            "right one",
            [_two(factor * f.corrected) for f, (factor, _) in zip(each, shown, strict=True)],
        ),
        TableColumn("its coverage", [coverage_text(f) for f in each]),
        TableColumn("because of", [cause_word(f) for f in each], left=True),
    ]
    out.print()
    print_table(out, TITLE, columns)
    for sentence in cause_sentences(found):
        print_paragraph(out, sentence, 0)


def print_levels(found: Findings, out: Console) -> None:
    """A row a level, and whether all are as assumed."""
    items = found.levels.items if found.levels is not None else ()
    columns = [
        TableColumn("noise of", [item.name for item in items], left=True),
        TableColumn("unit", [shown_in(item.unit, item.name)[1] for item in items], left=True),
        TableColumn("assumed", [level_text(item, item.assumed) for item in items]),
        TableColumn("by likelihood", [level_text(item, item.found) for item in items]),
        TableColumn("agree", ["yes" if item.agrees else "no" for item in items], left=True),
    ]
    print_table(out, LEVELS_TITLE, columns)
    print_paragraph(out, levels_sentence(found), 0)


def level_text(item: Level, value: float) -> str:
    """A level in the unit in which it is shown; of process noise as a factor on the declared
    deviations.
    """
    if value == 0.0:
        return "none"
    if item.name in (STATES, PARAMETERS):
        return "as declared" if value == 1.0 else f"{value:.2g} times" if item.assumed else "some"
    return f"{shown_in(item.unit, item.name)[0] * value:.4g}"


def levels_sentence(found: Findings) -> str:
    """Whether the levels that are assumed are those under which the records are most probable;
    nothing where these were not looked for.
    """
    levels = found.levels
    if levels is None:
        return ""
    off = [item for item in levels.items if not item.agrees]
    over = f"over {levels.runs} runs"
    if not off:
        return f"noise levels by likelihood {over} agree with those that are assumed"
    said = (
        f"noise levels by likelihood {over} disagree with those that are assumed: "
        f"{'; '.join(_off(item) for item in off)}"
    )
    forced = any(item.name in (STATES, PARAMETERS) and item.found > 0.0 for item in off)
    return (
        f"{said}; that process noise stands for what the model cannot follow"
        if forced and found.misfits
        else said
    )


def _off(item: Level) -> str:
    if item.name not in (STATES, PARAMETERS):
        return (
            f"noise of {item.name} {item.found / item.assumed:.2f} times the assumed standard "
            "deviation"
        )
    if item.assumed == 0.0:
        return f"{item.name}, of which none is assumed, acts"
    return (
        f"{item.name}: none acts"
        if item.found == 0.0
        else f"{item.name} {item.found:.2g} times the assumed standard deviation"
    )


def direction(finding: Finding) -> str:
    """``"too small by 3.2"``: the factor that makes two sigmas hold 95.4 % of the errors."""
    factor = finding.wrong.factor
    return (
        f"too small by {_factor(factor)}"
        if factor > 1.0
        else f"too large by {_factor(1.0 / max(factor, 1e-12))}"
    )


def coverage_text(finding: Finding) -> str:
    """Share within two right sigmas, with its interval."""
    within = finding.coverage
    return (
        f"{100 * within.share:.1f} % ({100 * within.interval[0]:.1f} to "
        f"{100 * within.interval[1]:.1f})"
    )


def cause_sentences(found: Findings) -> list[str]:
    """For each set of causes the parameters it concerns, what it is, and how that was told."""
    groups: dict[tuple[tuple[str, ...], bool], list[Finding]] = {}
    for each in found.found:
        groups.setdefault((each.causes, each.again), []).append(each)
    said = {
        key: "; and ".join(_SAID[cause](group, found) for cause in key[0])
        for key, group in groups.items()
    }
    return [
        f"{_directions(group)}: {said[key]}{_how(group, found)}" for key, group in groups.items()
    ]


def _directions(group: list[Finding]) -> str:
    """By what the sigmas of a group are wrong."""
    parts = []
    for small, word in ((True, "too small"), (False, "too large")):
        factors = sorted(
            f.wrong.factor if small else 1.0 / max(f.wrong.factor, 1e-12)
            for f in group
            if f.wrong.too_small is small
        )
        if factors:
            ends = (
                _factor(factors[0])
                if _factor(factors[0]) == _factor(factors[-1])
                else f"{_factor(factors[0])} to {_factor(factors[-1])}"
            )
            parts.append(f"{word} by {ends}")
    return f"{'sigmas' if len(group) > 1 else 'sigma'} of {_names(group)} {' and '.join(parts)}"


def _how(group: list[Finding], found: Findings) -> str:
    """From where the right sigma comes."""
    if group[0].again:
        return (
            f". With that changed, {found.again} of the runs computed again have the right sigma "
            "above"
        )
    if group[0].causes[-1] in (MODEL, NOISE, OPEN):
        return ". The right sigma is of half the runs, its coverage of the other half"
    return ". The right sigma follows from that alone, its coverage is that of all runs"


def _start(group: list[Finding], found: Findings) -> str:
    return (
        "the estimator starts too far off and linearises there: started again from its own "
        f"result, {FURTHER} passes more, it is right"
    )


def _steps(group: list[Finding], found: Findings) -> str:
    return (
        "its integration is too coarse and moves the estimates: with fourth-order steps of a "
        "quarter of a sample they are not moved"
    )


def _levels(group: list[Finding], found: Findings) -> str:
    return (
        f"it assumes wrong noise ({_what_is_off(found)}): with the levels by likelihood it is right"
    )


def _what_is_off(found: Findings) -> str:
    items = found.levels.items if found.levels is not None else ()
    return "; ".join(_off(item) for item in items if not item.agrees)


def _prior(group: list[Finding], found: Findings) -> str:
    if math.isnan(group[0].strength):
        return (
            "estimates lean on the prior and scatter less than stated: started again from their "
            "own result, where it counts no more, they do"
        )
    shares = [100 * each.strength for each in group]
    share = (
        f"{min(shares):.0f} %"
        if max(shares) - min(shares) < 1.0
        else f"{min(shares):.0f} to {max(shares):.0f} %"
    )
    return (
        f"the prior gives {share} of the stated variance; the runs share its wrong mean, about "
        "which estimates neither scatter nor centre"
    )


def _colour(group: list[Finding], found: Findings) -> str:
    return (
        f"the noise is not white, neighbouring samples correlate by {group[0].strength:.2f} and "
        "tell less than the filter counts"
    )


def _noise(group: list[Finding], found: Findings) -> str:
    return (
        "the noise itself biases the estimate (it stands in what is not linear, or in regressors): "
        "with a tenth of it the bias goes"
    )


def _model(group: list[Finding], found: Findings) -> str:
    share = max(each.wrong.mean**2 / each.wrong.rms**2 for each in group)
    said = f"bias makes up to {100 * share:.0f} % of the mean square error"
    if not any(each.wrong.too_small for each in group):
        said += "; what is declared in its place, process noise, is more than it needs"
    left = (
        f"at the reference values it leaves {group[0].strength:.2g} times the noise, the same in "
        "all runs"
    )
    return f"the model cannot follow the flight: {left}; {said}"


def _open(group: list[Finding], found: Findings) -> str:
    share = max(each.wrong.mean**2 / each.wrong.rms**2 for each in group)
    said = f"bias makes up to {100 * share:.0f} % of the mean square error"
    return (
        "no cause was found: the model follows the flight, and nothing that was changed makes it "
        f"right; {said}"
    )


_SAID: dict[str, Callable[[list[Finding], Findings], str]] = {
    START: _start,
    TRIALS_STEPS: _steps,
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
    return (
        f"{few} ({100 * group[0].wrong.statistics.two.share:.1f} % within two sigmas, not "
        f"{100 * NORMAL[2]:.1f} %)"
        if len(names) == 1
        else few
    )


def _factor(value: float) -> str:
    return f"{value:.2f}" if value < 10.0 else f"{value:.0f}"


def _two(value: float) -> str:
    return number_text(value, value)


# ---- Why sigmas are wrong, on the page of a campaign and in its document

NONE = (
    "No reported sigma is told from a right one by these runs: the two-sigma coverage of every "
    "parameter is that of a normal distribution."
)


def findings_blocks(found: Findings) -> list[Block]:
    """The table of wrong sigmas with the right ones and a sentence for each cause, or that there is
    none; noise levels.
    """
    blocks: list[Block] = []
    if found.found:
        headings = (
            Column("parameter"),
            Column("multiply σ by", PURE),
            Column("reported σ", BY_ROW),
            Column("right σ", BY_ROW),
        )
        shares = (
            Column("its coverage", "%"),
            Column("from", "%"),
            Column("to", "%"),
            Column("because of"),
        )
        rows = tuple(_row(each) for each in found.found)
        blocks.append(
            Table(
                TITLE.capitalize(),
                (*headings, *shares),
                rows,
                tuple(each.wrong.statistics.unit for each in found.found),
            )
        )
        blocks.append(Bullets(tuple(as_sentence(each) for each in cause_sentences(found))))
    else:
        blocks.append(Prose(NONE))
    return blocks + (_levels_blocks(found, found.levels) if found.levels is not None else [])


def _levels_blocks(found: Findings, levels: Levels) -> list[Block]:
    """Noise levels by likelihood beside those assumed."""
    outputs = [item for item in levels.items if item.name not in (STATES, PARAMETERS)]
    columns = (
        Column("noise of"),
        Column("assumed σ", BY_ROW),
        Column("σ by likelihood", BY_ROW),
        Column("agree"),
    )
    rows = tuple(
        (item.name, _level(item.assumed), _level(item.found, item), "yes" if item.agrees else "no")
        for item in outputs
    )
    table = Table(LEVELS_TITLE.capitalize(), columns, rows, tuple(item.unit for item in outputs))
    forced = [
        f"{item.name}: assumed {level_text(item, item.assumed)}, by likelihood "
        f"{level_text(item, item.found)}"
        for item in levels.items[len(outputs) :]
    ]
    return [
        table,
        *(Prose(as_sentence(each)) for each in forced),
        Prose(as_sentence(levels_sentence(found))),
    ]


def findings_content(found: Findings) -> dict[str, Any]:
    """For ``campaign.json``: wrong sigmas by parameter, in SI, and noise levels where they were
    looked for.
    """
    content: dict[str, Any] = {
        "wrong_sigmas": {each.name: _content(each) for each in found.found},
        "because": cause_sentences(found),
    }
    if found.levels is not None:
        items = {
            item.name: {
                "unit": item.unit,
                "assumed": item.assumed,
                "by_likelihood": item.found,
                "agrees": item.agrees,
            }
            for item in found.levels.items
        }
        content["noise_levels"] = {"runs": found.levels.runs, "levels": items}
    return content


def _content(each: Finding) -> dict[str, Any]:
    within = each.coverage
    numbers = {
        "factor": each.wrong.factor,
        "reported_std": each.wrong.statistics.reported,
        "right_std": each.corrected,
    }
    shares = {
        "right_within_2": within.share,
        "right_within_2_low": within.interval[0],
        "right_within_2_high": within.interval[1],
    }
    return {
        "causes": list(each.causes),
        **numbers,
        **shares,
        "runs": within.runs,
        "computed_again": each.again,
    }


def _row(each: Finding) -> tuple[Cell, ...]:
    within, sizes = each.coverage, (each.wrong.statistics.reported, each.corrected)
    shares = (Number(100.0 * value, digits=1) for value in (within.share, *within.interval))
    factor = Number(each.wrong.factor, shown=number_text(each.wrong.factor, each.wrong.factor))
    return (
        each.name,
        factor,
        *(Number(size, shown=number_text(size, size)) for size in sizes),
        *shares,
        cause_word(each),
    )


def _level(value: float, item: Level | None = None) -> Cell:
    if value == 0.0:
        return "none"
    spread = value * item.spread if item is not None and 0.0 < item.spread < 1.0 else None
    return Number(value, spread)


# ---- The page of a campaign

TWO_SIGMA = 0.9545  # of a normal distribution


def campaign_page(
    campaign: CampaignRuns, judgement: Judgement, drawn: Sequence[Drawn] = ()
) -> Page:
    """The page of a campaign with the figures ``drawn``."""
    scenario, seeds, pooled = campaign.scenario, campaign.seeds, campaign.pooled
    low, high = pooled.interval
    wrong = judgement.findings.found
    share = (
        f"{100 * pooled.within_two:.1f} % of all 2-sigma intervals hold the reference (95 % "
        f"interval {100 * low:.1f} to {100 * high:.1f} %, "
    )
    share += f"{100 * TWO_SIGMA:.1f} % expected)"
    worst = max(campaign.spreads, key=lambda s: abs(s.bias) / s.scatter if s.scatter > 0.0 else 0.0)
    bias = (
        f"largest bias: {worst.name}, {abs(worst.bias) / worst.scatter:.2f} of its scatter"
        if worst.scatter > 0.0
        else ""
    )
    why = "; ".join(f"{count} {way}" for way, count in campaign.failures.items())
    broken = (
        f"{campaign.broken} of {len(seeds)} runs broke down and are left out ({why})"
        if campaign.broken
        else ""
    )
    files = [("model", file.name, file.sha256) for file in scenario.files]
    command = [
        "flightid",
        "campaign",
        scenario.name,
        "--runs",
        str(len(seeds)),
        "--seed",
        str(campaign.root),
        "--method",
        campaign.estimation.name,
    ]
    return Page(
        title=f"{capital(scenario.title)}: {len(seeds)} runs",
        kind=f"Campaign of {scenario.name}, {campaign.estimation.label}",
        verdict="sigmas hold"
        if not wrong
        else f"{len(wrong)} of {len(campaign.names)} sigmas wrong",
        tone="good" if not wrong else "fair",
        sentence=as_sentence(share),
        summary=tuple(as_sentence(line) for line in (bias,) if line),
        warnings=tuple(
            as_sentence(line) for line in (broken, *cause_sentences(judgement.findings)) if line
        ),
        sections=(
            *section("Bias and scatter", *_sizes(campaign)),
            *section(
                "Whether the sigmas are right",
                *findings_blocks(judgement.findings),
                *statistics_blocks(judgement.statistics),
            ),
            *section("Figures", *figures(drawn)),
            *section(
                "How it was made",
                Prose(
                    f"Truth and model: {scenario.distance}. Each run has a seed of its own; "
                    "flightid run with it repeats one."
                ),
            ),
        ),
        reproduction=reproduction(
            command,
            f"The seeds of all runs spring from {campaign.root}; they stand in estimates.csv.",
            files,
        ),
        created=now(),
    )


def _sizes(campaign: CampaignRuns) -> list[Block]:
    headings = (
        Column("parameter"),
        *(Column(each, BY_ROW) for each in ("reference", "bias ± σ", "scatter", "reported σ")),
    )
    count = campaign.values.shape[1]
    rows = tuple(_size(s, count) for s in campaign.spreads)
    note = (
        "Bias: mean error with the sigma of a mean. Scatter: standard deviation of the estimates. "
        "Reported: root mean square of the sigmas."
    )
    return [
        Table(f"Over {count} runs", tuple(headings), rows, tuple(s.unit for s in campaign.spreads)),
        Prose(note, "note"),
    ]


def _size(s: Spread, count: int) -> tuple[Cell, ...]:
    return (
        s.name,
        Number(s.reference),
        Number(s.bias, s.scatter / count**0.5),
        _of_two(s.scatter),
        _of_two(s.reported),
    )


def _of_two(value: float) -> Cell:
    """A deviation with two digits."""
    return Number(value, shown=number_text(value, value))


# ---- A Monte-Carlo campaign printed and written


def print_campaign(
    campaign: CampaignRuns,
    out: Console | None = None,
    details: str = BELOW,
    judgement: Judgement | None = None,
) -> None:
    """A summary, the table of all parameters, what is judged of its sigmas where that is given, and
    how many runs broke down.
    """
    terminal = out or console()
    seeds = campaign.seeds
    title = (
        f"{campaign.scenario.name}: {len(seeds)} runs from seed {campaign.root}, "
        f"{campaign.estimation.label}"
    )
    spreads = tuple(_shown(s) for s in (*campaign.spreads, campaign.pooled))
    sizes = [
        TableColumn("parameter", [s.name for s in spreads], left=True),
        TableColumn("unit", [unit_cell(s.unit) for s in spreads], left=True),
        TableColumn("reference", [f"{s.reference:.5g}" for s in spreads]),
        # to the sigma of a mean
        TableColumn(
            "bias",
            [number_text(s.bias, s.scatter / campaign.values.shape[1] ** 0.5) for s in spreads],
        ),
        TableColumn("scatter", [number_text(s.scatter, s.scatter) for s in spreads]),
        TableColumn("reported", [number_text(s.reported, s.reported) for s in spreads]),
    ]
    shares = [
        TableColumn("within 2 sigma", [f"{100 * s.within_two:.1f} %" for s in spreads]),
        TableColumn(
            "95 % interval",
            [f"{100 * s.interval[0]:.1f} to {100 * s.interval[1]:.1f} %" for s in spreads],
        ),
    ]
    pooled, low_high = (
        campaign.pooled,
        " to ".join(f"{100 * end:.1f}" for end in campaign.pooled.interval),
    )
    settled = f"{len(seeds) - campaign.broken} of {len(seeds)} runs settled"
    result = (
        f"within 2 sigma {100 * pooled.within_two:.1f} % (95 % interval {low_high} %), within 1 "
        f"sigma {100 * pooled.within_one:.1f} %"
    )
    print_summary(terminal, Summary(title, settled, result, details=details))
    print_table(terminal, title, [*sizes, *shares])
    if judgement is not None:
        print_statistics(judgement.statistics, terminal)
        print_findings(judgement.findings, terminal)
    if campaign.broken:
        terminal.print(broken_words(campaign))


def broken_words(campaign: CampaignRuns) -> str:
    """How many runs are left out, and by what they ended."""
    why = "; ".join(f"{count} {way}" for way, count in campaign.failures.items())
    return f"{campaign.broken} of {len(campaign.seeds)} runs broke down and are left out ({why})"


def _shown(s: Spread) -> Spread:
    """The same in the unit in which it is shown."""
    factor, unit = shown_in(s.unit, s.name)
    sizes = {key: factor * getattr(s, key) for key in ("reference", "bias", "scatter", "reported")}
    return replace(s, unit=unit, **sizes)


def write_campaign(
    campaign: CampaignRuns, judgement: Judgement, out: Path, *, figures: Formats = USUAL
) -> Path:
    """Write ``campaign.json``, ``statistics.csv``, ``estimates.csv``, figures and the page into
    ``out``, whole or not at all; returns it.
    """
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(
            ["seed", *(column for name in campaign.names for column in (name, f"std_{name}"))]
        )
        sound = campaign.seeds[campaign.kept].tolist()
        for seed, value, std in zip(
            sound, campaign.values.T.tolist(), campaign.std.T.tolist(), strict=True
        ):
            writer.writerow(
                [seed, *(repr(cell) for pair in zip(value, std, strict=True) for cell in pair)]
            )
        (scratch / "statistics.csv").write_text(
            statistics_csv(judgement.statistics), encoding="utf-8", newline="\n"
        )
        (scratch / "estimates.csv").write_text(text.getvalue(), encoding="utf-8", newline="\n")
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import drawn_for_page
            from scenarios.studies.folder import campaign_figures

            drawn = drawn_for_page(
                campaign_figures(campaign, judgement.statistics), scratch, figures
            )
        write_page(scratch, campaign_page(campaign, judgement, drawn))
        content = {
            "schema": "flightid/campaign/1",
            "scenario": campaign.scenario.name,
            "method": campaign.estimation.name,
            "seed": campaign.root,
            "runs": len(campaign.seeds),
            **({"asked": campaign.asked} if campaign.asked > len(campaign.seeds) else {}),
            "broken": campaign.broken,
            **({"failures": dict(campaign.failures)} if campaign.failures else {}),
            "parameters": {s.name: _spread(s) for s in campaign.spreads},
            "pooled": {
                "within_one_sigma": campaign.pooled.within_one,
                "within_two_sigma": campaign.pooled.within_two,
                "interval": list(campaign.pooled.interval),
            },
            "statistics": statistics_content(judgement.statistics),
            **findings_content(judgement.findings),
            "versions": versions(),
        }
        write_json(scratch / "campaign.json", content)
    return out


def _spread(s: Spread) -> dict[str, Any]:
    return {
        "unit": s.unit,
        "reference": s.reference,
        "bias": s.bias,
        "scatter": s.scatter,
        "reported_std": s.reported,
        "within_one_sigma": s.within_one,
        "within_two_sigma": s.within_two,
        "interval": list(s.interval),
    }
