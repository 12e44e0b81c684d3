"""Numbers and figures of docs/records/cavour.md, with an integrator and a fit of their own.

    python docs/records/cavour.py FOLDER_OF_RECORDS [FOLDER_OF_FIGURES]

Nothing here uses the program's estimators: what both find does not hang on either.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    LABEL_SIZE,
    VERMILION,
    ZERO,
    finish,
    make_sheet,
    time_axis,
    y_label,
)

START = 44.0  # s, from where on the body falls near its terminal speed
DENSITY, GRAVITY, GAS, TEMPERATURE = 1.192, 9.80, 287.05, 296.0  # kg/m3, m/s2, J/(kg K), K
LAPSES = {"isothermal": 0.0, "standard lapse": 0.0065, "dry adiabat": 0.00976}  # K/m
CUTS = (52.0, 55.0, 58.0)  # s, up to which a prediction of the rest is fitted
BEGINS = (START, 46.0, 48.0, 52.0)  # s, from which on the scale height is left free
BLOCKS = 6
COLOURS = {"isothermal": VERMILION, "standard lapse": GREEN, "dry adiabat": BLUE}


def scale_height(lapse: float) -> float:
    """Scale height of the density near the ground, m: R T / (g - R lapse)."""
    return GAS * TEMPERATURE / (GRAVITY - GAS * lapse)


def load(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and height (m) of the fall."""
    table = np.genfromtxt(folder / "cavour_ballistic.csv", delimiter=",", names=True)
    falling = table["time"] >= START
    return table["time"][falling], table["h"][falling]


def fall(start: np.ndarray, height: float, time: np.ndarray, begin: float = START) -> np.ndarray:
    """Heights (m) of a body with start = (height, speed, beta) at ``begin`` in air of that scale
    height.
    """

    def rates(_: float, y: np.ndarray) -> tuple[float, float]:
        return y[1], -0.5 * DENSITY * np.exp(-y[0] / height) / start[2] * y[1] * abs(y[1]) - GRAVITY

    return np.asarray(
        solve_ivp(
            rates, (begin, max(time[-1], begin + 1.0)), start[:2], t_eval=time, rtol=1e-8, atol=1e-6
        ).y[0]
    )


def fitted(time: np.ndarray, heights: np.ndarray, height: float) -> np.ndarray:
    """Start height, start speed and beta by least squares."""
    found = least_squares(
        lambda q: fall(q, height, time) - heights,
        [1623.0, -73.0, 310.0],
        x_scale=[1.0, 1.0, 30.0],
        diff_step=1e-5,
    )
    return np.asarray(found.x)


def fitted_with_height(time: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """The same, at the first sample, and the scale height."""
    begin, guess = time[0], [heights[0], -74.0, 310.0, 1e4]
    found = least_squares(
        lambda q: fall(q[:3], q[3], time, begin) - heights,
        guess,
        x_scale=[1.0, 1.0, 30.0, 3e3],
        diff_step=1e-4,
    )
    return np.asarray(found.x)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def lag_one(values: np.ndarray) -> float:
    return float(values[1:] @ values[:-1] / (values @ values))


@dataclass(frozen=True, eq=False)
class Swing:
    """A decaying oscillation of the residual: amplitude (m) at START, time of decay (s), frequency
    (Hz), and what it leaves.
    """

    amplitude: float
    decay: float
    frequency: float
    left: np.ndarray


def swing(time: np.ndarray, residual: np.ndarray) -> Swing:
    """The oscillation that lowers the residual most."""
    since = time - START

    def shape(p: np.ndarray) -> np.ndarray:
        return np.asarray(
            np.exp(-since / (1.0 + abs(p[2])))
            * (p[0] * np.cos(2 * np.pi * p[3] * since) + p[1] * np.sin(2 * np.pi * p[3] * since))
        )

    tries = [
        least_squares(lambda p: shape(p) - residual, [1.0, 0.0, 20.0, f])
        for f in np.arange(0.40, 0.64, 0.02)
    ]
    best = min(tries, key=lambda found: found.cost).x
    return Swing(
        float(np.hypot(best[0], best[1])),
        1.0 + abs(float(best[2])),
        float(best[3]),
        residual - shape(best),
    )


def scatter_of_height(
    time: np.ndarray, heights: np.ndarray, best: np.ndarray, draws: int = 40
) -> float:
    """Standard deviation of the fitted scale height where blocks of 4 s of the residual are drawn
    anew.
    """
    rng, line = np.random.default_rng(0), fall(best[:3], best[3], time, time[0])
    residual, size = heights - line, 28
    found = []
    for _ in range(draws):
        pieces = [
            residual[at : at + size]
            for at in rng.integers(0, len(time) - size, 1 + len(time) // size)
        ]
        found.append(fitted_with_height(time, line + np.concatenate(pieces)[: len(time)])[3])
    return float(np.std(found))


def report(folder: Path) -> str:
    """The numbers, one line each."""
    time, heights = load(folder)
    lines = []
    for name, lapse in LAPSES.items():
        height = scale_height(lapse)
        start = fitted(time, heights, height)
        residual = heights - fall(start, height, time)
        ahead = [
            rms(
                (
                    heights
                    - fall(fitted(time[time <= cut], heights[time <= cut], height), height, time)
                )[time > cut]
            )
            for cut in CUTS
        ]
        lines.append(
            f"{name}: scale height {height:.0f} m, beta {start[2]:.1f} kg/m2, residual "
            f"{rms(residual):.2f} m, lag-1 {lag_one(residual):.2f}"
        )
        lines.append(
            f"{name}: rest predicted from 8, 11, 14 s with error "
            f"{', '.join(f'{each:.1f}' for each in ahead)} m"
        )
        lines.append(f"{name}: blocks left out {rms_of_blocks(time, heights, height):.1f} m")
    for begin in BEGINS:
        late = time >= begin
        best = fitted_with_height(time[late], heights[late])
        scatter = scatter_of_height(time[late], heights[late], best)
        lines.append(
            f"free scale height from {begin:g} s on: {best[3] / 1e3:.1f} +- {scatter / 1e3:.1f} "
            f"km, beta {best[2]:.0f} kg/m2"
        )
    height = scale_height(LAPSES["dry adiabat"])
    found = swing(time, heights - fall(fitted(time, heights, height), height, time))
    peak = found.amplitude * (2 * np.pi * found.frequency) ** 2
    share = DENSITY * GRAVITY * found.amplitude / (0.5 * DENSITY * 74.0**2)
    lines.append(
        f"swing: {found.frequency:.3f} Hz, {found.amplitude:.1f} m at first, decays in "
        f"{found.decay:.0f} s; leaves {rms(found.left):.2f} m"
    )
    lines.append(
        f"swing: as a motion {peak / GRAVITY:.1f} g, as an error of the static pressure "
        f"{100 * share:.1f} % of the dynamic pressure"
    )
    return "\n".join(lines)


def rms_of_blocks(time: np.ndarray, heights: np.ndarray, height: float) -> float:
    """Error on blocks that were left out of the fit, each in turn, m."""
    edges = np.linspace(START, time[-1] + 1e-3, BLOCKS + 1)
    squares = []
    for low, high in pairwise(edges):
        out = (time >= low) & (time < high)
        squares.append(
            ((heights - fall(fitted(time[~out], heights[~out], height), height, time))[out]) ** 2
        )
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def figure_residual(time: np.ndarray, heights: np.ndarray) -> Figure:
    """What is left of the height, fitted throughout, and fitted to the first 11 s alone."""
    sheet = make_sheet([1.6, 1.6], row_gap=0.32)
    whole, ahead = sheet.panels
    for name in ("isothermal", "dry adiabat"):
        height = scale_height(LAPSES[name])
        first = time <= CUTS[1]
        for panel, used in ((whole, time > 0.0), (ahead, first)):
            residual = heights - fall(fitted(time[used], heights[used], height), height, time)
            panel.plot(
                time,
                residual,
                color=COLOURS[name],
                linewidth=1.1,
                marker=".",
                markersize=3.0,
                label=name,
            )
    for panel, text in (
        (whole, "fitted to all of it"),
        (ahead, f"fitted up to {CUTS[1]:g} s, predicted from there on"),
    ):
        panel.axhline(0.0, **ZERO)
        panel.set_title(text, fontsize=LABEL_SIZE, loc="left")
        y_label(panel, "measured - model (m)")
    ahead.axvline(CUTS[1], color=BLACK, linewidth=0.8, linestyle=":")
    time_axis(ahead)
    return finish(sheet, "Cavour: height left by a fall with constant drag", head=0.24)


def figure_density(time: np.ndarray, heights: np.ndarray) -> Figure:
    """rho v^2/(2 g) along the fall for three profiles; spectrum of what is left."""
    sheet = make_sheet([2.2], (1.0, 1.0), share_x=False, column_gap=0.75)
    left, right = sheet.panels
    half = 1.9  # s, about one period of the swing on either side
    centres = np.arange(time[0] + half, time[-1] - half, 0.5)
    local = np.array(
        [
            np.polyfit(time[near] - c, heights[near], 2)[1:]
            for c in centres
            for near in [np.abs(time - c) <= half]
        ]
    )
    for name, lapse in LAPSES.items():
        share = (
            DENSITY
            * np.exp(-local[:, 1] / scale_height(lapse))
            * local[:, 0] ** 2
            / (2.0 * GRAVITY)
        )
        left.plot(local[:, 1], share, color=COLOURS[name], linewidth=1.3, label=name)
    left.set_xlabel("height (m)", fontsize=LABEL_SIZE)
    left.set_title("ρ v²/(2 g) over 3.8 s (kg/m²)", fontsize=LABEL_SIZE, loc="left")
    frequencies = np.linspace(0.05, 2.0, 300)
    for name in ("isothermal", "dry adiabat"):
        height = scale_height(LAPSES[name])
        residual = heights - fall(fitted(time, heights, height), height, time)
        right.plot(
            frequencies,
            [amplitude(time, residual, f) for f in frequencies],
            color=COLOURS[name],
            linewidth=1.2,
        )
    right.set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    right.set_title("amplitude of the residual (m)", fontsize=LABEL_SIZE, loc="left")
    return finish(sheet, "Cavour: the air by height, and the rhythm of what is left", head=0.24)


def amplitude(time: np.ndarray, values: np.ndarray, frequency: float) -> float:
    """Amplitude of the sine of this frequency that fits best."""
    basis = np.stack(
        [
            np.cos(2 * np.pi * frequency * time),
            np.sin(2 * np.pi * frequency * time),
            np.ones_like(time),
        ],
        axis=1,
    )
    found = np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.hypot(found[0], found[1]))


def main(arguments: list[str]) -> None:
    records = Path(arguments[0])
    print(report(records))
    if len(arguments) > 1:
        for stem, draw in (
            ("cavour-residual", figure_residual),
            ("cavour-density", figure_density),
        ):
            draw(*load(records)).savefig(Path(arguments[1]) / f"{stem}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
