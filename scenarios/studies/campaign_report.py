"""A campaign in the terminal and on its page: parameters, statistics, causes of wrong sigmas."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console

from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    Block,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    capital,
    known,
    now,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import Drawn
from scenarios.report.folder import figures
from scenarios.report.quantities import console, number_text, shown_in
from scenarios.report.summary import BELOW, Summary, print_summary
from scenarios.report.terminal import show_blocks, show_table
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
from scenarios.studies.campaign_statistics import NORMAL, SIGMAS, CampaignStatistics, Squares
from scenarios.studies.campaign_trials import (
    FURTHER_PASSES,
    LEVELS,
    PARAMETERS,
    START,
    STATES,
    TRIALS_STEPS,
    Level,
    Levels,
)
from scenarios.studies.comparison import distance_text

# ---- Statistics of a campaign in sentences and tables

# Statistic -> its meaning in words.
MEANINGS = {
    "NEES": "squared error in units of the reported covariance, all parameters together",
    "NIS": "squared innovation in units of its own",
}


def squares_sentence(squares: Squares) -> str:
    """Return the mean of NEES or NIS over its degrees of freedom, with its expected interval."""
    low, high = squares.interval
    if squares.right:
        verdict = "as it should be"
    else:
        verdict = "too large" if squares.mean > high else "too small"
    mean = f"{squares.mean:.3f}" if squares.mean < 100.0 else number_text(squares.mean)
    return (
        f"{squares.name} ({MEANINGS[squares.name]}) over its degrees of freedom: "
        f"{mean}, {verdict} (correct sigmas give "
        f"{low:.3f} to {high:.3f} in 95 % of campaigns); {100 * squares.inside:.1f} % of the "
        "runs within their own 95 % interval"
    )


NOTE = (
    "Efficiency: variance of the Cramer-Rao bound at the reference over that of the estimates; 1 "
    "is the best possible. The bound includes the priors of the method. All intervals are at "
    "95 %: those of ratios by chi-square, those of shares by Clopper and Pearson."
)


def two_digits(value: float) -> Cell:
    """Return a table cell with two significant digits."""
    return Number(value, shown=number_text(value, value))


def percent(shares: Iterable[float]) -> list[Cell]:
    """Return table cells with shares in percent."""
    return [Number(100.0 * share, digits=1) for share in shares]


def statistics_blocks(statistics: CampaignStatistics) -> list[Block]:
    """Return the tables of scatter and bound, of coverage, and of NEES and NIS."""
    parameters = statistics.parameters
    names = (Column("parameter"), [p.name for p in parameters])
    displayed = [(p, shown_in(p.unit, p.name)) for p in parameters]
    ends = [p.efficiency_interval or (None, None) for p in parameters]
    sizes = table(
        "scatter against the reported sigma and the Cramer-Rao bound",
        names,
        (
            Column("bias ± σ", BY_ROW, printed="bias"),
            [Number(s.factor * p.bias, s.factor * p.bias_std) for p, s in displayed],
        ),
        (Column("scatter / reported", PURE), [known(p.ratio, 3) for p in parameters]),
        (Column("from", PURE), [known(p.ratio_interval[0], 3) for p in parameters]),
        (Column("to", PURE), [known(p.ratio_interval[1], 3) for p in parameters]),
        (
            Column("bound", BY_ROW),
            [MISSING if p.bound is None else two_digits(s.factor * p.bound) for p, s in displayed],
        ),
        (Column("efficiency", PURE), [known(p.efficiency, 3) for p in parameters]),
        (Column("from", PURE), [known(low, 3) for low, _ in ends]),
        (Column("to", PURE), [known(high, 3) for _, high in ends]),
        units=[s.unit for _, s in displayed],
    )
    shares: list[tuple[Column, list[Cell]]] = []
    for i, sigmas in enumerate(SIGMAS):
        coverages = [p.coverage[i] for p in parameters]
        parts = {
            f"within {sigmas} σ": [within.share for within in coverages],
            "from": [within.interval[0] for within in coverages],
            "to": [within.interval[1] for within in coverages],
        }
        for heading, values in parts.items():
            column = Column(heading, "%", printed=f"{heading.replace('σ', 'sigma')}, %")
            shares.append((column, percent(values)))
    coverage = table(
        "share of the runs whose interval contains the reference (a normal distribution's: 68.3, "
        "95.4, 99.7 %)",
        names,
        *shares,
    )
    squares = [
        Prose(squares_sentence(s)) for s in (statistics.nees, statistics.nis) if s is not None
    ]
    return [sizes, coverage, Prose(NOTE, "note"), *squares]


# ---- Causes of wrong sigmas in tables and sentences

TITLE = "wrong sigmas, their causes, and sigmas with each cause removed"
LEVELS_TITLE = "noise levels by likelihood beside those that are assumed"
NONE = (
    "no reported sigma differs significantly from the scatter of these runs: the two-sigma "
    "coverage of every parameter is that of a normal distribution"
)

# Cause -> its word in tables and its sentence.
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
    """Return the causes in a word or two each."""
    return " + ".join(_WORDS[cause] for cause in finding.causes)


def findings_blocks(findings: Findings) -> list[Block]:
    """Return the table of wrong sigmas, a sentence on each cause, and noise levels."""
    blocks = levels_blocks(findings, findings.levels) if findings.levels is not None else []
    if not findings.found:
        return [*blocks, Prose(NONE)]
    displayed = [(f, shown_in(f.wrong.statistics.unit, f.name)) for f in findings.found]

    corrected = table(
        TITLE,
        (Column("parameter"), [f.name for f in findings.found]),
        (
            Column("reported σ is", PURE, printed="reported is", left=True),
            [Number(f.wrong.factor, shown=direction(f)) for f in findings.found],
        ),
        (
            Column("reported σ", BY_ROW, printed="reported"),
            [two_digits(s.factor * f.wrong.statistics.reported) for f, s in displayed],
        ),
        (
            Column("σ without the cause", BY_ROW, printed="without the cause"),
            [two_digits(s.factor * f.corrected) for f, s in displayed],
        ),
        (Column("its coverage", "%"), percent(f.coverage.share for f in findings.found)),
        (Column("from", "%"), percent(f.coverage.interval[0] for f in findings.found)),
        (Column("to", "%"), percent(f.coverage.interval[1] for f in findings.found)),
        (Column("cause"), [cause_word(f) for f in findings.found]),
        units=[s.unit for _, s in displayed],
    )
    return [*blocks, corrected, *map(Prose, cause_sentences(findings))]


def levels_blocks(findings: Findings, levels: Levels) -> list[Block]:
    """Return a table of noise levels, and a sentence on whether the assumed ones are correct."""
    items = levels.items
    shown = table(
        LEVELS_TITLE,
        (Column("noise of"), [item.name for item in items]),
        (Column("assumed", BY_ROW), [_level_cell(item, item.assumed, 0.0) for item in items]),
        (
            Column("by likelihood", BY_ROW),
            [_level_cell(item, item.found, item.spread) for item in items],
        ),
        (Column("agree"), ["yes" if item.agrees else "no" for item in items]),
        units=[shown_in(item.unit, item.name).unit for item in items],
    )
    return [shown, Prose(levels_sentence(findings))]


def _level_cell(item: Level, value: float, spread: float) -> Cell:
    if value == 0.0 or item.name in (STATES, PARAMETERS):
        return level_text(item, value)
    scaled = shown_in(item.unit, item.name).factor * value
    sigma = scaled * spread if 0.0 < spread < 1.0 else None
    return Number(scaled, sigma, shown=level_text(item, value))


def level_text(item: Level, value: float) -> str:
    """Return a noise level in its display unit; process noise as a factor on the declared sigma."""
    if value == 0.0:
        return "none"
    if item.name in (STATES, PARAMETERS):
        return "as declared" if value == 1.0 else f"{value:.2g} times" if item.assumed else "some"
    return f"{shown_in(item.unit, item.name)[0] * value:.4g}"


def levels_sentence(findings: Findings) -> str:
    """Return whether the assumed noise levels maximise the likelihood; empty if not estimated."""
    levels = findings.levels
    if levels is None:
        return ""
    over = f"over {levels.runs} runs"
    if levels.agree:
        return f"noise levels by likelihood {over} agree with those that are assumed"
    sentence = (
        f"noise levels by likelihood {over} disagree with those that are assumed: "
        f"{_disagreements(levels)}"
    )
    has_process_noise = any(
        item.name in (STATES, PARAMETERS) and item.found > 0.0 and not item.agrees
        for item in levels.items
    )
    if has_process_noise and findings.misfits:
        sentence += "; that process noise stands for what the model cannot follow"
    return sentence


def _disagreements(levels: Levels | None) -> str:
    """Return the noise levels that differ from the assumed ones, in words."""
    items = levels.items if levels is not None else ()
    return "; ".join(_disagreement(item) for item in items if not item.agrees)


def _disagreement(item: Level) -> str:
    if item.name not in (STATES, PARAMETERS):
        return (
            f"noise of {item.name} {item.found / item.assumed:.2f} times the assumed standard "
            "deviation"
        )
    if item.assumed == 0.0:
        return f"{item.name}, of which none is assumed, acts"
    if item.found == 0.0:
        return f"{item.name}: none acts"
    return f"{item.name} {item.found:.2g} times the assumed standard deviation"


def direction(finding: Finding) -> str:
    """Return the error of a sigma, such as ``"too small by a factor of 3.2"``.

    With this factor on the sigma, two sigmas contain 95.4 % of the errors.
    """
    return _by_factors([finding])


def _by_factors(group: list[Finding]) -> str:
    """Return the smallest and the largest factor by which sigmas of one direction are wrong."""
    small = group[0].wrong.too_small
    factors = sorted(f.wrong.factor if small else 1.0 / max(f.wrong.factor, 1e-12) for f in group)
    ends = dict.fromkeys(
        f"{end:.2f}" if end < 10.0 else f"{end:.0f}" for end in (factors[0], factors[-1])
    )
    return f"too {'small' if small else 'large'} by a factor of {' to '.join(ends)}"


def cause_sentences(findings: Findings) -> list[str]:
    """Return one sentence per set of causes: parameters, cause, and evidence."""
    groups: dict[tuple[tuple[str, ...], bool], list[Finding]] = {}
    for finding in findings.found:
        groups.setdefault((finding.causes, finding.again), []).append(finding)
    sentences = []
    for (causes, _), group in groups.items():
        reasons = "; and ".join(_explanation(cause, group, findings) for cause in causes)
        sentences.append(f"{_directions(group)}: {reasons}{_correction_note(group, findings)}")
    return sentences


def _directions(group: list[Finding]) -> str:
    """Return the factors by which the sigmas of a group are wrong."""
    sides = ([f for f in group if f.wrong.too_small is small] for small in (True, False))
    parts = " and ".join(_by_factors(side) for side in sides if side)
    return f"{'sigmas' if len(group) > 1 else 'sigma'} of {_names(group)} {parts}"


def _correction_note(group: list[Finding], findings: Findings) -> str:
    """Return a sentence on the source of the corrected sigma, after a full stop."""
    if group[0].again:
        return (
            f". The table has sigma and coverage of {findings.again} runs repeated without this "
            "cause; where their sigma equals the reported one, their errors are smaller"
        )
    if group[0].causes[-1] in (MODEL, NOISE, OPEN):
        return (
            ". The corrected sigma follows from half of the runs, its coverage from the other half"
        )
    return ". The corrected sigma follows from this cause alone, its coverage from all runs"


def _explanation(cause: str, group: list[Finding], findings: Findings) -> str:
    """Return a sentence on a cause, with its evidence."""
    strength = group[0].strength
    if cause == START:
        return (
            "the estimator starts too far off and linearises there: started again from its own "
            f"result, {FURTHER_PASSES} passes more, it is right"
        )
    if cause == TRIALS_STEPS:
        return (
            "its integration is too coarse and moves the estimates: with fourth-order steps of a "
            "quarter of a sample they are not moved"
        )
    if cause == LEVELS:
        wrong = _disagreements(findings.levels)
        return f"it assumes wrong noise ({wrong}): with the levels by likelihood it is right"
    if cause == PRIOR:
        return _prior_sentence(group)
    if cause == COLOUR:
        return (
            f"the noise is not white, neighbouring samples correlate by {strength:.2f} and "
            "tell less than the filter counts"
        )
    if cause == NOISE:
        return (
            "the noise itself biases the estimate (it stands in what is not linear, or in "
            "regressors): with a tenth of it the bias goes"
        )
    if cause == OPEN:
        return (
            "no cause was found: the model follows the flight, and nothing that was changed makes "
            f"it right; {_bias_share(group)}"
        )
    more = ""
    if not any(finding.wrong.too_small for finding in group):
        more = "; what is declared in its place, process noise, is more than it needs"
    return (
        f"the model cannot follow the flight: at the reference values it leaves {strength:.2g} "
        f"times the noise, the same in all runs; {_bias_share(group)}{more}"
    )


def _prior_sentence(group: list[Finding]) -> str:
    if math.isnan(group[0].strength):
        return (
            "estimates lean on the prior and scatter less than stated: started again from their "
            "own result, where it counts no more, they do"
        )
    shares = [100 * finding.strength for finding in group]
    share = f"{min(shares):.0f} %"
    if max(shares) - min(shares) >= 1.0:
        share = f"{min(shares):.0f} to {max(shares):.0f} %"
    return (
        f"the prior gives {share} of the stated variance; the runs share its wrong mean, about "
        "which estimates neither scatter nor centre"
    )


def _bias_share(group: list[Finding]) -> str:
    share = max(finding.wrong.mean**2 / finding.wrong.rms**2 for finding in group)
    return f"bias makes up to {100 * share:.0f} % of the mean square error"


def _names(group: list[Finding]) -> str:
    """Return the parameters of a group; a single one with its coverage."""
    if len(group) == 1:
        share = group[0].wrong.statistics.two.share
        return (
            f"{group[0].name} ({100 * share:.1f} % within two sigmas, not {100 * NORMAL[2]:.1f} %)"
        )
    more = f" and {len(group) - 8} more" if len(group) > 8 else ""
    return ", ".join(finding.name for finding in group[:8]) + more


# ---- Causes of wrong sigmas in campaign.json


def findings_content(findings: Findings) -> dict[str, Any]:
    """Return content of ``campaign.json``: wrong sigmas by parameter, SI, causes and noise levels.

    Without noise levels if they were not estimated.
    """
    content: dict[str, Any] = {
        "wrong_sigmas": {finding.name: _content(finding) for finding in findings.found},
        "because": cause_sentences(findings),
    }
    if findings.levels is not None:
        items = {
            item.name: {
                "unit": item.unit,
                "assumed": item.assumed,
                "by_likelihood": item.found,
                "agrees": item.agrees,
            }
            for item in findings.levels.items
        }
        content["noise_levels"] = {"runs": findings.levels.runs, "levels": items}
    return content


def _content(finding: Finding) -> dict[str, Any]:
    within = finding.coverage
    return {
        "causes": list(finding.causes),
        "factor": finding.wrong.factor,
        "reported_std": finding.wrong.statistics.reported,
        "right_std": finding.corrected,
        "right_within_2": within.share,
        "right_within_2_low": within.interval[0],
        "right_within_2_high": within.interval[1],
        "runs": within.runs,
        "computed_again": finding.again,
    }


# ---- A campaign in the terminal, and its table of parameters


SIZES_NOTE = (
    "Bias: mean error with its standard error. Scatter: standard deviation over the runs. "
    "Reported: root mean square of the sigmas. Row all: errors of all parameters, each in units "
    "of the sigma that its own run reports."
)


def sizes_table(campaign: CampaignRuns) -> Table:
    """Return bias, scatter and coverage of each parameter; pooled values in reported sigmas."""
    spreads = tuple(_displayed(s) for s in (*campaign.spreads, campaign.pooled))
    root = campaign.values.shape[1] ** 0.5

    return table(
        campaign_title(campaign),
        (Column("parameter"), [s.name for s in spreads]),
        (Column("reference", BY_ROW), [Number(s.reference) for s in spreads]),
        (
            Column("bias ± σ", BY_ROW, printed="bias"),
            [Number(s.bias, s.scatter / root) for s in spreads],
        ),
        (Column("scatter", BY_ROW), [two_digits(s.scatter) for s in spreads]),
        (
            Column("reported σ", BY_ROW, printed="reported"),
            [two_digits(s.reported) for s in spreads],
        ),
        (
            Column("within 2 σ", "%", printed="within 2 sigma, %"),
            percent(s.within_two for s in spreads),
        ),
        (Column("95 % from", "%", printed="from"), percent(s.interval[0] for s in spreads)),
        (
            Column("to", "%", printed="to (95 %)", beside=True),
            percent(s.interval[1] for s in spreads),
        ),
        units=[s.unit for s in spreads],
    )


def campaign_title(campaign: CampaignRuns) -> str:
    """Return the title of a campaign: scenario, number of runs, seed and method."""
    return (
        f"{campaign.scenario.name}: {len(campaign.seeds)} runs from seed {campaign.root}, "
        f"{campaign.estimation.label}"
    )


def print_campaign(
    campaign: CampaignRuns,
    out: Console | None = None,
    details: str = BELOW,
    judgement: Judgement | None = None,
) -> None:
    """Print a summary, the table of parameters, the judgement of sigmas, and failed runs."""
    terminal = out or console()
    seeds = campaign.seeds
    title = campaign_title(campaign)
    pooled = campaign.pooled
    low_high = " to ".join(f"{100 * end:.1f}" for end in campaign.pooled.interval)
    settled = f"{len(seeds) - campaign.broken} of {len(seeds)} runs settled"
    result = (
        f"within 2 sigma {100 * pooled.within_two:.1f} % (95 % interval {low_high} %), within 1 "
        f"sigma {100 * pooled.within_one:.1f} %"
    )
    print_summary(terminal, Summary(title, settled, result, details=details))
    show_table(terminal, sizes_table(campaign))
    if judgement is not None:
        show_blocks(terminal, statistics_blocks(judgement.statistics), apart=True)
        show_blocks(terminal, findings_blocks(judgement.findings), apart=True)
    if campaign.broken:
        terminal.print(broken_words(campaign))


def broken_words(campaign: CampaignRuns) -> str:
    """Return the number of runs left out, and the reasons."""
    why = "; ".join(f"{count} {way}" for way, count in campaign.failures.items())
    return f"{campaign.broken} of {len(campaign.seeds)} runs broke down and are left out ({why})"


def _displayed(s: Spread) -> Spread:
    factor, unit = shown_in(s.unit, s.name)
    sizes = {key: factor * getattr(s, key) for key in ("reference", "bias", "scatter", "reported")}
    return replace(s, unit=unit, **sizes)


# ---- The page of a campaign


def campaign_page(
    campaign: CampaignRuns, judgement: Judgement, drawn: Sequence[Drawn] = ()
) -> Page:
    """Return the page of a campaign with the figures ``drawn``."""
    scenario, seeds, pooled = campaign.scenario, campaign.seeds, campaign.pooled
    low, high = pooled.interval
    wrong = judgement.findings.found
    share = (
        f"{100 * pooled.within_two:.1f} % of all two-sigma intervals contain the reference (95 % "
        f"interval {100 * low:.1f} to {100 * high:.1f} %, {100 * NORMAL[2]:.1f} % expected)"
    )
    biases = {s.name: abs(s.bias) / s.scatter for s in campaign.spreads if s.scatter > 0.0}
    bias = ""
    if biases:
        worst = max(biases, key=lambda name: biases[name])
        bias = f"largest bias: {worst}, {biases[worst]:.2f} of its scatter"
    broken = broken_words(campaign) if campaign.broken else ""
    files = [("model", file.name, file.sha256) for file in scenario.files]
    command = ["flightid", "campaign", scenario.name, "--runs", str(len(seeds))]
    command += ["--seed", str(campaign.root), "--method", campaign.estimation.name]
    return Page(
        title=f"{capital(scenario.title)}: {len(seeds)} runs",
        kind=f"Campaign of {scenario.name}, {campaign.estimation.label}",
        verdict=f"{len(wrong)} of {len(campaign.names)} sigmas wrong" if wrong else "sigmas hold",
        tone="good" if not wrong else "fair",
        sentence=as_sentence(share),
        summary=tuple(as_sentence(line) for line in (bias,) if line),
        warnings=tuple(
            as_sentence(line) for line in (broken, *cause_sentences(judgement.findings)) if line
        ),
        sections=(
            *section("Figures", *figures(drawn)),
            *section("Bias and scatter", sizes_table(campaign), Prose(SIZES_NOTE, "note")),
            *section(
                "Whether the sigmas are right",
                *findings_blocks(judgement.findings),
                *statistics_blocks(judgement.statistics),
            ),
            *section(
                "How it was made",
                Prose(
                    f"Flight and model: {distance_text(scenario.distance)}. Each run has its own "
                    "seed, with which flightid run repeats it."
                ),
            ),
        ),
        reproduction=reproduction(
            command,
            f"The seeds of all runs follow from seed {campaign.root}; estimates.csv lists them.",
            files,
        ),
        created=now(),
    )
