"""How often the sigmas of every scenario hold: the plan of runs, the campaigns, the page and the
command.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from exam.options import Parser
from scenarios.report.document import as_sentence
from scenarios.studies.campaign import Rebuilt, fly_campaign
from scenarios.studies.campaign_causes import Finding, judge
from scenarios.studies.campaign_report import cause_sentences, cause_word
from scenarios.studies.campaign_statistics import ParameterStatistics
from scenarios.studies.catalogue import load_document, load_scenario
from scenarios.tasks.study import Execution
from sim.errors import FlightidError

# ---- Which methods of which scenarios are measured, and with how many runs

SEED = 1
LOW, HIGH = 0.93, 0.97  # acceptable two-sigma coverage
IDENTIFIABLE = 0.5  # largest share of a reported variance that may come from the prior

# (scenario, method): runs. The first of a scenario is its main method.
RUNS: dict[tuple[str, str], int] = {
    ("rigid", "main"): 1000,
    ("rigid-euler", "main"): 1000,
    ("rigid-euler", "runge-kutta"): 1000,
    ("rigid-process-noise-a", "main"): 1000,
    ("rigid-process-noise-b", "main"): 1000,
    ("ballistic", "main"): 1000,
    ("ballistic", "one-pass"): 1000,
    ("ballistic", "paper-start-rk4"): 1000,
    ("ballistic", "paper-start-cured"): 1000,
    ("ballistic", "output-error"): 400,
    ("ballistic-process-noise", "main"): 1000,
    ("flexible-ac1-equivalent", "main"): 1000,
    ("flexible-ac1-equivalent", "no-process-noise"): 1000,
    ("flexible-ac1-equivalent", "output-error"): 200,
    ("flexible-ac2-equivalent", "main"): 1000,
    ("flexible-ac1-first-mode", "main"): 500,
    ("flexible-ac1-first-mode", "output-error"): 300,
    ("flexible-ac2-first-mode", "main"): 500,
    ("flexible-ac2-first-mode", "output-error"): 300,
    ("flexible-ac1-full-order", "main"): 150,
    ("flexibility-sweep", "main"): 500,
    ("lateral", "main"): 1000,
    ("longitudinal", "main"): 300,
    ("own-model", "main"): 1000,
    ("own-model", "filter"): 1000,
    ("aircraft-airliner", "main"): 200,
    ("aircraft-f16", "main"): 40,
    ("aircraft-uav", "main"): 200,
    ("unstable", "main"): 200,
    ("unstable", "filter"): 200,
    ("unstable", "regression"): 200,
}


# ---- One campaign and what is judged of its sigmas, as JSON


def measured(name: str, method: str, runs: int, jobs: int | None = 1) -> dict[str, Any]:
    """Return the coverage of each parameter, and the cause of wrong sigmas. Raises FlightidError as
    ``fly_campaign``.
    """
    document, short, where = load_document(name)
    rebuilt_scenario = Rebuilt(
        {key: value for key, value in document.items() if key != "kind"}, short, where
    )
    campaign = fly_campaign(
        load_scenario(name),
        runs,
        SEED,
        method,
        execution=Execution(jobs),
        rebuilt_scenario=rebuilt_scenario,
    )
    judged = judge(campaign)
    why = {each.name: each for each in judged.findings.found}
    return {
        "scenario": name,
        "method": method,
        "label": campaign.estimation.label,
        "runs": runs,
        "settled": runs - campaign.broken,
        "parameters": {
            each.name: _parameter(each, why.get(each.name)) for each in judged.statistics.parameters
        },
        "because": cause_sentences(judged.findings),
    }


def _parameter(each: ParameterStatistics, finding: Finding | None) -> dict[str, Any]:
    content: dict[str, Any] = {
        "within_2": each.two.share,
        "low": each.two.interval[0],
        "high": each.two.interval[1],
    }
    content |= {"prior_share": each.prior_share} if each.prior_share is not None else {}
    if finding is None:
        return content
    right = finding.coverage
    wrong = {
        "factor": finding.wrong.factor,
        "because_of": cause_word(finding),
        "right_within_2": right.share,
        "right_runs": right.runs,
    }
    return {
        **content,
        "wrong": {**wrong, "right_low": right.interval[0], "right_high": right.interval[1]},
    }


# ---- The measured coverage of all scenarios as a page

HEAD = """# Whether the sigmas of every scenario hold

How many of {count} parameters have a two-sigma coverage of {low:.0f} to {high:.0f} %, and which sigma is wrong and why where it is not. Each row is a
[campaign](how-to/campaigns.md) from seed 1: the flight of the scenario measured or flown as often as it says, the share of the runs whose
interval of two reported sigmas holds the reference, its exact 95 % interval. Why a sigma is wrong is told from the runs themselves,
[as described there](how-to/campaigns.md#which-sigma-is-wrong-and-why); the coverage of the runs without that cause follows.

| | parameters |
|---|---|
{counts}

Sigmas called wrong though their coverage lies within these bounds, for many runs tell small things: {inside}. Not identifiable is a parameter
of whose stated variance the prior gives more than {prior:.0f} %: over runs with the same prior it does not scatter as it states. "Not told" are those
whose coverage lies outside, but whose interval holds the 95.4 % of a normal distribution where it is widened so that one right campaign in
twenty is suspected of anything: the runs are too few to call the sigma wrong. The page is written by
[exam/coverage](../exam/coverage/README.md); its numbers lie beside it as JSON.
"""  # noqa: E501
COLUMNS = "| parameter | within 2σ | 95 % interval | judged |\n|---|---|---|---|\n"
INSIDE, TOLD = (
    "coverage of 93 to 97 %, sigma not called wrong",
    "sigma called wrong, with the reason",
)
PRIOR, OPEN = "not identifiable: the prior gives most of the variance", "not told"
KINDS = (INSIDE, TOLD, PRIOR, OPEN)


def page_of(found: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of all campaigns in their order."""
    every = [each for campaign in found for each in campaign["parameters"].values()]
    counts = Counter(_kind(each) for each in every)
    inside = sum("wrong" in each and LOW <= each["within_2"] <= HIGH for each in every)
    lines = "\n".join(f"| {name} | {counts[name]} |" for name in KINDS)
    head = HEAD.format(
        count=len(every),
        low=100 * LOW,
        high=100 * HIGH,
        inside=inside,
        prior=100 * IDENTIFIABLE,
        counts=lines,
    )
    parts = []
    for number, campaign in enumerate(found):
        parts.append(
            _section(
                campaign, first=number == 0 or found[number - 1]["scenario"] != campaign["scenario"]
            )
        )
    return head + "".join(parts)


def _kind(each: Mapping[str, Any]) -> str:
    """Return which of ``KINDS`` a parameter is."""
    if "wrong" in each:
        return TOLD
    if LOW <= each["within_2"] <= HIGH:
        return INSIDE
    return PRIOR if each.get("prior_share", 0.0) > IDENTIFIABLE else OPEN


def _section(campaign: Mapping[str, Any], *, first: bool) -> str:
    """Return the table of one campaign, below the heading of its scenario."""
    heading = f"\n## {campaign['scenario']}\n" if first else ""
    left = (
        ""
        if campaign["settled"] == campaign["runs"]
        else f", of which {campaign['settled']} settled"
    )
    rows = "".join(_row(name, each) for name, each in campaign["parameters"].items())
    why = "".join(f"\n- {as_sentence(each)}" for each in campaign["because"])
    return (
        f"{heading}\n{_capital(campaign['label'])} (`{campaign['method']}`), {campaign['runs']} "
        f"runs{left}:\n\n{COLUMNS}{rows}" + (f"{why}\n" if why else "")
    )


def _row(name: str, each: Mapping[str, Any]) -> str:
    return (
        f"| {name} | {100 * each['within_2']:.1f} % | {100 * each['low']:.1f} to "
        f"{100 * each['high']:.1f} % | {judged(each)} |\n"
    )


def judged(each: Mapping[str, Any]) -> str:
    """Return the assessment of one parameter."""
    kind = _kind(each)
    if kind == PRIOR:
        return f"not identifiable: {100 * each['prior_share']:.0f} % of the variance is the prior's"
    if kind != TOLD:
        return "holds" if kind == INSIDE else "not told from 95.4 %"
    wrong = each["wrong"]
    factor = wrong["factor"]
    size = (
        f"too small by a factor of {_size(factor)}"
        if factor > 1.0
        else f"too large by a factor of {_size(1.0 / max(factor, 1e-12))}"
    )
    right = (
        f"{100 * wrong['right_within_2']:.1f} % ({100 * wrong['right_low']:.1f} to "
        f"{100 * wrong['right_high']:.1f} %)"
    )
    return f"σ {size}: {wrong['because_of']}; without this cause {right}"


def _size(factor: float) -> str:
    return f"{factor:.2f}" if factor < 10.0 else f"{factor:.0f}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


# ---- Write the page

PAGE = Path("docs/campaign-statistics.md")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the requested campaigns, store the numbers beside the page after each one, and write the
    page; return 2 with one line on failure.
    """
    parser = Parser("coverage", "coverage of the sigmas of every scenario")
    parser.add_argument(
        "--page",
        type=Path,
        default=PAGE,
        help=f"the page; its numbers go beside it as .json (default: {PAGE})",
    )
    parser.add_argument(
        "--kept",
        action="store_true",
        help="run nothing: write the page anew from the numbers beside it",
    )
    parser.add_argument(
        "--only",
        action="append",
        metavar="SCENARIO",
        help="measure these alone, and keep what is there of the others",
    )
    parser.add_argument("--jobs", type=int, default=None, help="processes (default: one a core)")
    asked = parser.parse_args(arguments)
    numbers: Path = asked.page.with_suffix(".json")
    try:
        found = _kept(numbers) if asked.kept or asked.only else {}
        for name, method in () if asked.kept else RUNS:
            if asked.only is None or name in asked.only:
                print(f"{name}, {method}", file=sys.stderr, flush=True)
                found[name, method] = measured(name, method, RUNS[name, method], asked.jobs)
                _keep(numbers, found)
        asked.page.write_text(page_of(_ordered(found)), encoding="utf-8", newline="\n")
    except (FlightidError, OSError, ValueError, KeyError) as error:
        print(f"python -m exam coverage: {error}", file=sys.stderr)
        return 2
    print(f"written: {asked.page}")
    return 0


def _kept(numbers: Path) -> dict[tuple[str, str], dict[str, Any]]:
    if not numbers.is_file():
        return {}
    return {
        (each["scenario"], each["method"]): each
        for each in json.loads(numbers.read_text(encoding="utf-8"))["campaigns"]
    }


def _keep(numbers: Path, found: dict[tuple[str, str], dict[str, Any]]) -> None:
    numbers.write_text(
        json.dumps({"schema": "flightid/coverage/1", "campaigns": _ordered(found)}, indent=1)
        + "\n",
        encoding="utf-8",
        newline="\n",
    )


def _ordered(found: dict[tuple[str, str], dict[str, Any]]) -> list[dict[str, Any]]:
    """Sort by the order of the plan; entries that are not in the plan are left out."""
    return [found[key] for key in RUNS if key in found]
