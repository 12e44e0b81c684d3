"""The measured coverage of all scenarios as a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from exam.coverage.plan import HIGH, IDENTIFIABLE, LOW
from scenarios.report.document import as_sentence

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
    """The page of all campaigns in their order."""
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
    """Which of ``KINDS`` a parameter is."""
    if "wrong" in each:
        return TOLD
    if LOW <= each["within_2"] <= HIGH:
        return INSIDE
    return PRIOR if each.get("prior_share", 0.0) > IDENTIFIABLE else OPEN


def _section(campaign: Mapping[str, Any], *, first: bool) -> str:
    """A table of one campaign, below the heading of its scenario."""
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
    """What is said of one parameter."""
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
