"""Statistics of a campaign for ``campaign.json``, and as ``statistics.csv``."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

from scenarios.studies.campaign_statistics.statistics import CampaignStatistics, ParameterStatistics, Squares


def statistics_content(found: CampaignStatistics) -> dict[str, Any]:
    """Of each parameter and of NEES and NIS; what there is not is left out."""
    content: dict[str, Any] = {"parameters": {each.name: _parameter(each) for each in found.parameters}}
    return content | {each.name.lower(): _squares(each) for each in (found.nees, found.nis) if each is not None}


def statistics_csv(found: CampaignStatistics) -> str:
    """A row a parameter, SI; a cell is empty where there is nothing."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    rows = [_flat(each) for each in found.parameters]
    writer.writerow(rows[0])
    for row in rows:
        writer.writerow([cell if isinstance(cell, str) else "" if cell is None else repr(cell) for cell in row.values()])
    return text.getvalue()


def _parameter(each: ParameterStatistics) -> dict[str, Any]:
    return {key: value for key, value in _flat(each).items() if value is not None}


def _flat(each: ParameterStatistics) -> dict[str, Any]:
    row: dict[str, Any] = {"parameter": each.name, "unit": each.unit, "runs": each.two.runs, "reference": each.reference}
    row |= {"bias": each.bias, "bias_std": each.bias_std, "scatter": each.scatter, "reported_std": each.reported}
    row |= {"ratio": _finite(each.ratio), "ratio_low": _finite(each.ratio_interval[0]), "ratio_high": _finite(each.ratio_interval[1])}
    for share in each.coverage:
        row |= {
            f"within_{share.sigmas}": share.share,
            f"within_{share.sigmas}_low": share.interval[0],
            f"within_{share.sigmas}_high": share.interval[1],
        }
    low, high = each.efficiency_interval or (None, None)
    row |= {"bound_std": each.bound, "prior_pull": each.pull, "prior_share": each.prior_share}
    return row | {"efficiency": each.efficiency, "efficiency_low": low, "efficiency_high": _finite(high)}


def _squares(each: Squares) -> dict[str, Any]:
    ends = {"low": each.interval[0], "high": each.interval[1]}
    return {"mean": each.mean, **ends, "inside": each.inside, "inside_low": each.inside_interval[0], "inside_high": each.inside_interval[1]}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
