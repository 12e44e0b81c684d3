"""The picture of a diagnosis in the README: ``python docs/_ext/diagnosis_picture.py`` writes
``docs/diagnosis.svg``.

The scenario ``trace-delay`` is flown and diagnosed. The picture shows the pitch rate of the record
that was not fitted: measured, and predicted by the model before and after the diagnosis.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

PICTURE = Path(__file__).parents[1] / "diagnosis.svg"
SCENARIO, CHANNEL = "trace-delay", "q"
SPAN = 0.0, 10.0  # s of the record that are shown


def predictions(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Any]:
    """Fly and diagnose the scenario.

    Parameters
    ----------
    folder : an empty folder, for the study.

    Returns
    -------
    tuple of time (s), and measured, before and after (deg/s), each ``(N,)``; and the diagnosis.
    """
    import pandas as pd

    import flightid as fid

    flight = fid.simulate(SCENARIO)
    found = fid.diagnose(flight.record, "rigid", flight.vehicle, validate=flight.validate)
    table = pd.read_csv(found.save(folder / "study", figures=False) / "validate_prediction.csv")
    measured = np.rad2deg(flight.validate[0][CHANNEL])
    before, after = (np.rad2deg(table[f"{when}_{CHANNEL}"]) for when in ("before", "after"))
    return table["time"].to_numpy(), measured, before.to_numpy(), after.to_numpy(), found


def draw(
    time: np.ndarray,
    measured: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    verdict: str,
    path: Path,
) -> Path:
    """Write the picture: predictions above, residuals below, the verdict as the title.

    Parameters
    ----------
    time : s, ``(N,)``. measured, before, after : pitch rate, deg/s, ``(N,)``.
    verdict : the title. path : the file to write; its ending says which format.

    Returns
    -------
    path
    """
    import matplotlib

    matplotlib.use("svg")
    from matplotlib.figure import Figure

    from scenarios.plots.style import BLUE, GREY, VERMILION

    shown = (time >= SPAN[0]) & (time <= SPAN[1])
    t, z, old, new = (each[shown] for each in (time, measured, before, after))
    with matplotlib.rc_context({"svg.hashsalt": "flightid", "font.size": 9.0}):
        figure = Figure(figsize=(7.6, 3.9), layout="constrained", facecolor="white")
        rows = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        rows[0].plot(t, z, ".", color=GREY, markersize=2.5, label="measured, not fitted")
        rows[0].plot(t, old, "--", color=VERMILION, linewidth=1.5, label="declared model")
        rows[0].plot(t, new, "-", color=BLUE, linewidth=1.5, label="with the traced effect")
        rows[0].set_ylabel("pitch rate, deg/s")
        rows[0].legend(loc="upper right", ncols=3, frameon=False, fontsize=8.0)
        rows[0].margins(y=0.22)
        rows[0].set_title(verdict, fontsize=10.5, fontweight="bold", loc="left")
        for series, colour in ((z - old, VERMILION), (z - new, BLUE)):
            rows[1].plot(t, series, color=colour, linewidth=0.9)
        rows[1].axhline(0.0, color="black", linewidth=0.6)
        rows[1].set_ylabel("residual, deg/s")
        rows[1].set_xlabel("time, s")
        for axes in rows:
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(alpha=0.25)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    return path


def main() -> None:
    """Write the picture."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--out", type=Path, default=PICTURE)
    path: Path = asked.parse_args().out
    with TemporaryDirectory() as folder:
        time, measured, before, after, found = predictions(Path(folder))
    effect = found.effects[0]
    delay = effect.parameters["delay"]
    rms = [float(np.sqrt(np.mean((measured - each) ** 2))) for each in (before, after)]
    title = (
        f"{found.verdict.capitalize()}: {effect.name.replace('-', ' ')} {delay.value:.3f} s; "
        f"pitch-rate error {rms[0]:.2f} \N{RIGHTWARDS ARROW} {rms[1]:.2f} deg/s"
    )
    print(draw(time, measured, before, after, title, path))


if __name__ == "__main__":
    main()
