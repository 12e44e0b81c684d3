"""Numbers and figures of docs/records/prometheus.md: heights of two barometers against acceleration
and satellite fixes.

    python docs/records/prometheus.py FOLDER_OF_RECORDS [FOLDER_OF_FIGURES]
    python docs/records/prometheus.py FOLDER_OF_RECORDS --fixes > fixes.csv

No drag model and none of the program's estimators: the motion is integrated from the measured
acceleration.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
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
    TICK_SIZE,
    VERMILION,
    ZERO,
    finish,
    make_sheet,
    time_axis,
    y_label,
)

BEGIN, END, STEP = 5.3, 27.0, 5  # s, s, samples that are averaged
GRAVITY, GAS = 9.79, 287.05
MASS, AREA = 16.91, np.pi * 0.06985**2
PAD_HEIGHT, PAD_PRESSURE = 1394.0, 86440.0  # m by the receivers, Pa
HORIZONTAL = 26.0  # m/s at BEGIN, by the receivers
ZERO_STD = 0.2  # m/s2, how far an accelerometer's zero is believed to be off
ALTIMETERS = ("telemetrum", "telemega")
COLOURS = {"telemetrum": BLUE, "telemega": VERMILION}
# K at the pad and K/m: the thickness of the air by satellite, lapse of a dry desert noon
WARM = (302.4, 0.0098)
USUAL = (295.3, 0.0065)  # the same thickness, standard lapse


@dataclass(frozen=True, eq=False)
class Coast:
    """One altimeter's coast, averaged over a few samples: time, height of the standard atmosphere,
    drag deceleration, pressure; all ``(N,)``.

    ``fixes`` holds time and height over the pad, ``(2, K)``, of new satellite fixes. ``rest`` is
    the mean reading on the pad, ``closing`` the speed that the acceleration leaves at the highest
    point, m/s; ``scale`` the highest reading of the barometer over the highest fix.
    """

    time: np.ndarray
    height: np.ndarray
    drag: np.ndarray
    pressure: np.ndarray
    fixes: np.ndarray
    rest: float
    closing: float
    scale: float


def load(folder: Path, name: str) -> Coast:
    """Read one altimeter."""
    table = np.genfromtxt(
        folder / f"prometheus_{name}.csv", delimiter=",", names=True, dtype=None, encoding="utf8"
    )
    time, reading = table["time"], table["accel"]
    coast = np.flatnonzero((time >= BEGIN - 1e-9) & (time <= END + 1e-9))
    groups = coast[: len(coast) // STEP * STEP].reshape(-1, STEP)
    new = np.r_[False, np.diff(table["h_gps"]) != 0] & (time > 6.0) & (time < END)
    flown = (time > -0.3) & (time < 29.3)
    return Coast(
        time[groups].mean(axis=1),
        table["h_isa"][groups].mean(axis=1),
        -(reading[groups].mean(axis=1) + 9.80665),
        table["pressure"][groups].mean(axis=1),
        np.stack([time[new], table["h_gps"][new] - PAD_HEIGHT]),
        float(reading[time < -0.2].mean()),
        float(np.trapezoid(reading[flown], time[flown])),
        float(
            np.max(table["h_isa"][time < 30.0])
            / (np.nanmax(table["h_gps"][time < 30.0]) - PAD_HEIGHT)
        ),
    )


def motion(coast: Coast, height: float, speed: float, zero: float) -> np.ndarray:
    """Height, vertical and horizontal speed ``(3, N)`` that the measured deceleration along the
    path gives.
    """
    out = np.empty((3, len(coast.time)))
    out[:, 0] = height, speed, HORIZONTAL
    for i, step in enumerate(np.diff(coast.time)):
        z, up, along = out[:, i]
        share = (0.5 * (coast.drag[i] + coast.drag[i + 1]) + zero) / np.hypot(up, along)
        rise, forward = -GRAVITY - share * up, -share * along
        out[:, i + 1] = (
            z + step * up + 0.5 * step**2 * rise,
            up + step * rise,
            along + step * forward,
        )
    return out


@dataclass(frozen=True, eq=False)
class Fitted:
    """A barometer explained by the measured acceleration: start height, start speed, zero of the
    accelerometer, port, scale; sigmas; what is left; the motion."""

    values: np.ndarray
    std: np.ndarray
    residual: np.ndarray
    moved: np.ndarray


def explained(coast: Coast, scale: float, port: bool, any_scale: bool = False) -> Fitted:
    """Fit start, zero and, if wanted, static port and scale; ``scale`` turns heights into those of
    the standard atmosphere.
    """

    def heights(q: np.ndarray) -> np.ndarray:
        moved = motion(coast, *q[:3])
        return np.asarray(q[4] * moved[0] - q[3] * moved[1] ** 2 / (2.0 * GRAVITY))

    def misfit(q: np.ndarray) -> np.ndarray:
        return np.r_[
            heights(q) - coast.height,
            q[2] / ZERO_STD,
            0.0 if port else 1e6 * q[3],
            0.0 if any_scale else 1e6 * (q[4] - scale),
        ]

    guess = [coast.height[0] / scale, 310.0, 0.0, 0.0, scale]
    found = least_squares(misfit, guess, x_scale=[10.0, 10.0, 0.1, 0.02, 0.05], diff_step=1e-4)
    left = coast.height - heights(found.x)
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac))) * left.std()
    return Fitted(found.x, spread, left, motion(coast, *found.x[:3]))


def against_fixes(
    coast: Coast, moved: np.ndarray, port: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """Satellite fixes = barometer x factor + port v^2/(2 g) - lateness v: values, sigmas, rms;
    lateness in s.
    """
    at, fixes = coast.fixes
    speed = np.interp(at, coast.time, moved[1])
    columns = [
        np.interp(at, coast.time, coast.height),
        -speed,
        *([speed**2 / (2.0 * GRAVITY)] if port else []),
    ]
    basis = np.stack(columns, axis=1)
    found = np.linalg.lstsq(basis, fixes, rcond=None)[0]
    left = fixes - basis @ found
    spread = np.sqrt(
        np.diag(np.linalg.inv(basis.T @ basis)) * (left @ left) / (len(fixes) - len(found))
    )
    return found, spread, float(np.sqrt(np.mean(left**2)))


def drag_coefficient(coast: Coast, moved: np.ndarray, air: tuple[float, float]) -> np.ndarray:
    """Drag coefficient ``(N,)`` from deceleration, speed and measured pressure in air of that
    temperature.
    """
    density = coast.pressure / (GAS * (air[0] - air[1] * moved[0]))
    return np.asarray(MASS * coast.drag / (0.5 * density * (moved[1] ** 2 + moved[2] ** 2) * AREA))


def tilt_share(coefficient: float = 0.33, speed: float = 312.0) -> float:
    """By how much a vertical model finds too much drag on this path that leans: a fit to the
    heights of a simulated one.
    """
    time = np.linspace(0.0, END - BEGIN, 100)

    def heights(start: float, horizontal: float, drag: float) -> np.ndarray:
        def rates(_: float, y: np.ndarray) -> list[float]:
            pressure = (
                0.5 * 1.085 * np.exp(-y[0] / 9550.0) * np.hypot(y[1], y[2]) * drag * AREA / MASS
            )
            return [y[1], -GRAVITY - pressure * y[1], -pressure * y[2]]

        return np.asarray(
            solve_ivp(rates, (0.0, time[-1]), [700.0, start, horizontal], t_eval=time, rtol=1e-8).y[
                0
            ]
        )

    true = heights(speed, HORIZONTAL, coefficient)
    found = least_squares(
        lambda q: heights(q[0], 0.0, q[1]) + q[2] - true,
        [speed, coefficient, 0.0],
        x_scale=[10.0, 0.01, 1.0],
    )
    return float(found.x[1] / coefficient - 1.0)


def report(folder: Path) -> str:
    """The numbers, one line each."""
    coasts = {name: load(folder, name) for name in ALTIMETERS}
    scale = coasts["telemega"].scale
    lines = [
        f"at the top the height of the standard atmosphere is {scale:.3f} of that by satellite"
    ]
    for name, coast in coasts.items():
        lines.append(
            f"{name}: accelerometer on the pad {coast.rest:+.2f} m/s2; speed left at the top "
            f"{coast.closing:+.1f} m/s"
        )
        plain, with_port = explained(coast, scale, port=False), explained(coast, scale, port=True)
        lines.append(
            f"{name}: heights by acceleration, no port: left {plain.residual.std():.1f} m, zero "
            f"{plain.values[2]:+.1f} m/s2"
        )
        free = explained(coast, scale, port=False, any_scale=True)
        lines.append(
            f"{name}: any scale, no port: left {free.residual.std():.1f} m, scale "
            f"{free.values[4]:.2f}, zero {free.values[2]:+.1f} m/s2"
        )
        value, spread, zero = with_port.values[3], with_port.std[3], with_port.values[2]
        lines.append(
            f"{name}: with a port of {value:.3f} +- {spread:.3f}: left "
            f"{with_port.residual.std():.2f} m, zero {zero:+.1f} m/s2"
        )
        fast = with_port.moved[1] > 150.0
        means = [
            drag_coefficient(coast, with_port.moved, air)[fast].mean() for air in (USUAL, WARM)
        ]
        lines.append(
            f"{name}: drag coefficient above 150 m/s {means[0]:.3f} (standard lapse), "
            f"{means[1]:.3f} (dry adiabat)"
        )
    moved = explained(coasts["telemega"], scale, port=True).moved
    plain_fixes, port_fixes = (
        against_fixes(coasts["telemega"], moved, port) for port in (False, True)
    )
    lines.append(
        f"telemega: satellite fixes against barometer, no port: left {plain_fixes[2]:.1f} m"
    )
    found, spread, left = port_fixes
    lines.append(
        f"telemega: with a port of {found[2]:.3f} +- {spread[2]:.3f}, fixes {found[1]:.2f} s late: "
        f"left {left:.1f} m"
    )
    lines.append(f"the path leans: a vertical model finds {100 * tilt_share():.1f} % too much drag")
    return "\n".join(lines)


def figure_missing(coasts: dict[str, Coast], scale: float) -> Figure:
    """Height that the barometers lack, against the height v^2/(2 g) of the speed."""
    sheet = make_sheet([2.6])
    (panel,) = sheet.panels
    for name, coast in coasts.items():
        fit = explained(coast, scale, port=True)
        lack, size = scale * fit.moved[0] - coast.height, fit.moved[1] ** 2 / (2.0 * GRAVITY)
        panel.plot(
            size,
            lack,
            color=COLOURS[name],
            marker=".",
            markersize=2.5,
            linestyle="none",
            label=f"{name}: motion by its accelerometer",
        )
        panel.plot(
            [0.0, size[0]], [0.0, fit.values[3] * size[0]], color=COLOURS[name], linewidth=0.9
        )
    coast = coasts["telemega"]
    moved = explained(coast, scale, port=True).moved
    found, _, _ = against_fixes(coast, moved, port=True)
    at, fixes = coast.fixes
    speed = np.interp(at, coast.time, moved[1])
    lack = fixes + found[1] * speed - found[0] * np.interp(at, coast.time, coast.height)
    label = f"telemega: satellite fixes, {found[1]:.2f} s late"
    panel.plot(
        speed**2 / (2.0 * GRAVITY),
        lack,
        color=GREEN,
        marker="s",
        markersize=4.0,
        linestyle="none",
        label=label,
    )
    panel.axhline(0.0, **ZERO)
    panel.set_xlabel("v²/(2 g) (m)", fontsize=LABEL_SIZE)
    y_label(panel, "height missing (m)")
    return finish(sheet, "Prometheus: what the barometers lack grows with the dynamic pressure")


def figure_left(coasts: dict[str, Coast], scale: float) -> Figure:
    """What is left of the barometers' heights where the motion is that of the accelerometers; the
    drag they measure.
    """
    sheet = make_sheet([1.5, 1.5], row_gap=0.34)
    above, below = sheet.panels
    for name, coast in coasts.items():
        plain, with_port = (explained(coast, scale, port) for port in (False, True))
        above.plot(
            coast.time,
            plain.residual,
            color=COLOURS[name],
            linewidth=0.9,
            linestyle="--",
            label=f"{name}, heights taken as they are",
        )
        above.plot(
            coast.time,
            with_port.residual,
            color=COLOURS[name],
            linewidth=0.9,
            label=f"{name}, with a static port",
        )
        fast = with_port.moved[1] > 150.0
        seconds = np.ones(20) / 20.0
        drag = np.convolve(drag_coefficient(coast, with_port.moved, USUAL)[fast], seconds, "valid")
        below.plot(
            np.convolve(coast.time[fast], seconds, "valid"),
            drag,
            color=COLOURS[name],
            linewidth=1.2,
        )
    below.axhspan(
        0.405,
        0.428,
        color=BLACK,
        alpha=0.12,
        linewidth=0.0,
        label="constant drag fitted to the heights",
    )
    below.set_ylim(0.25, 0.45)
    below.text(
        19.5,
        0.335,
        "slower than 150 m/s the drag is lost\nin the accelerometers' zero",
        fontsize=TICK_SIZE,
        va="center",
    )
    above.axhline(0.0, **ZERO)
    above.set_title("height left (m)", fontsize=LABEL_SIZE, loc="left")
    below.set_title(
        "drag coefficient by the accelerometers, mean over 1 s", fontsize=LABEL_SIZE, loc="left"
    )
    time_axis(below)
    return finish(sheet, "Prometheus: heights and drag with the acceleration measured", head=0.24)


def main(arguments: list[str]) -> None:
    records = Path(arguments[0])
    if "--fixes" in arguments:
        at, heights = load(records, "telemega").fixes
        print(
            "time,altitude", *(f"{t:.2f},{h:g}" for t, h in zip(at, heights, strict=True)), sep="\n"
        )
        return
    print(report(records))
    if len(arguments) > 1:
        coasts = {name: load(records, name) for name in ALTIMETERS}
        for stem, draw in (
            ("prometheus-missing", figure_missing),
            ("prometheus-left", figure_left),
        ):
            draw(coasts, coasts["telemega"].scale).savefig(Path(arguments[1]) / f"{stem}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
