"""All ratios of a run in one figure, as performance.png beside the page."""

from __future__ import annotations

import io
from collections.abc import Sequence

from benchmarks.comparison.compare import Result
from benchmarks.comparison.job import Job
from benchmarks.comparison.timing import Quartiles

WARM, COLD = "#D55E00", "#0072B2"  # of Okabe and Ito's palette


def drawn(compared: Sequence[tuple[Job, Sequence[Result]]]) -> bytes:
    """A PNG: for each peer the time over flightid's, warm and cold, medians with quartiles, on a
    logarithmic axis; one job below the other.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [
        (f"{job.name}: {each.contender.label}", each.warm_ratio, each.cold_ratio)
        for job, results in compared
        for each in results[1:]
        if each.warm_ratio is not None and each.cold_ratio is not None
    ]
    figure = Figure(figsize=(8.0, 1.2 + 0.36 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, (_, warm, cold) in enumerate(rows):
        for ratio, colour, shift in ((warm, WARM, -0.15), (cold, COLD, 0.15)):
            axes.errorbar(
                ratio.median,
                i + shift,
                xerr=_whiskers(ratio),
                fmt="o",
                color=colour,
                markersize=4,
                linewidth=1,
            )
    for colour, label in ((WARM, "warm"), (COLD, "cold, whole process")):
        axes.plot([], [], "o", color=colour, markersize=4, label=label)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [label for label, _, _ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(axis="x", linewidth=0.3)
    axes.set_xlabel("time of the other over flightid's; right of 1 flightid is ahead")
    axes.legend(loc="lower right", fontsize="small")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()


def _whiskers(ratio: Quartiles) -> list[list[float]]:
    return [[max(ratio.median - ratio.lower, 0.0)], [max(ratio.upper - ratio.median, 0.0)]]
