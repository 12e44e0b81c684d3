"""Display of quantities: units, sigmas, numbers, and single lines of text.

| quantity | shown in |
|---|---|
| angles, their rates | deg, deg/s, deg/s2 |
| frequencies | rad/s, and Hz in brackets |
| everything else, such as derivatives and trims of the equations (L_0) | the unit that it has |

In computations and in JSON and CSV files all units are SI; load factors are in g.
"""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from ident.statistics.residuals import WHITENESS_P_VALUE, ResidualTest
from ident.tracing.diagnosis import Quantity
from scenarios.files.sources import escaped, styled_stream

# ---- Display units

DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2", "rad/s/s": "deg/s2"}
NO_UNIT = ("", "1")
# Quantities in rad/s or rad/s2 that are no angles, and are not shown in degrees: trims,
# effectiveness of commands, and the gain of a transfer function.
NOT_ANGLES = ("gain", "L_0", "M_0", "N_0", "L_lat", "M_lon", "N_ped")


class Shown(NamedTuple):
    """Display unit of a quantity: ``factor`` times its SI value is shown in ``unit``."""

    factor: float
    unit: str


def shown_in(unit: str, name: str = "") -> Shown:
    """Return the display unit; ``name`` distinguishes a frequency (rad/s) from a rate (deg/s)."""
    if unit in DEGREES and name not in NOT_ANGLES and not is_frequency(name, unit):
        return Shown(180.0 / math.pi, DEGREES[unit])
    return Shown(1.0, f"{unit.removesuffix('/s/s')}/s2" if unit.endswith("/s/s") else unit)


def quantity_text(value: float, unit: str, name: str = "") -> str:
    """Return a number without a sigma, such as ``"0.5 deg"`` or ``"12 rad/s (1.91 Hz)"``."""
    factor, shown = shown_in(unit, name)
    return f"{factor * value:.5g}{spaced(shown)}{in_hertz(value, name, unit)}"


def is_frequency(name: str, unit: str) -> bool:
    """Return whether unit and name are those of a frequency, such as ``natural_frequency`` or
    ``omega1``.
    """
    return unit == "rad/s" and (
        "frequency" in name or name.rpartition(".")[2].rstrip("0123456789") == "omega"
    )


def in_hertz(value: float, name: str, unit: str) -> str:
    """Return ``" (1.91 Hz)"`` for a frequency in rad/s, else an empty text."""
    return f" ({value / (2.0 * math.pi):.3g} Hz)" if is_frequency(name, unit) else ""


def unit_cell(unit: str) -> str:
    """Return a unit for a column of units, empty for a pure number."""
    return unit if unit not in NO_UNIT else ""


def spaced(unit: str) -> str:
    """Return a blank and the unit, to follow a number; empty for a pure number."""
    return f" {unit}" if unit not in NO_UNIT else ""


# ---- Quantities with their sigmas in display units

# Words for channels. A channel whose name is a word, such as airspeed or rudder, is not here.
CHANNELS = {
    "alpha": "angle of attack",
    "q": "pitch rate",
    "nz": "load factor",
    "theta": "pitch attitude",
    "nx": "axial load factor",
    "beta": "angle of sideslip",
    "p": "roll rate",
    "r": "yaw rate",
    "phi": "bank angle",
    "ny": "lateral load factor",
}
# Equation of motion that each channel belongs to.
AXES = {
    "airspeed": "speed",
    "nx": "speed",
    "alpha": "lift",
    "nz": "lift",
    "q": "pitch",
    "theta": "pitch",
    "beta": "side force",
    "ny": "side force",
    "p": "roll",
    "phi": "roll",
    "r": "yaw",
}

UNDETERMINED = "not determined by these data"


def with_sigma(quantity: Quantity, unit: str | None = None, name: str = "") -> str:
    """Return value and sigma in display units, such as ``"0.0610 +- 0.0012 s"``.

    The sigma gives the number of digits. ``unit`` replaces the display unit.
    """
    value, std, shown_unit = displayed(quantity, name)
    if name == "count":  # a number of events
        return f"{value:.0f}"
    if not determined(value, std):
        return UNDETERMINED
    return value_text(value, std, shown_unit if unit is None else unit) + in_hertz(
        value, name, shown_unit
    )


def value_text(value: float, std: float, unit: str = "") -> str:
    """Return ``"0.0610 +- 0.0012 s"``; ``"not determined"`` for a large sigma.

    A sigma of zero marks a value at its bound.
    """
    shown = spaced(unit)
    if std == 0.0 and value != 0.0:
        return f"{value:.5g}{shown} (bound)"
    if not determined(value, std):
        return "not determined"
    return f"{' +- '.join(value_parts(value, std))}{shown}"


def value_parts(value: float, std: float) -> tuple[str, str]:
    """Return the value and sigma as two texts, with two digits of the sigma."""
    decimals = max(0, 1 - math.floor(math.log10(std)))
    if decimals < 7:
        return f"{value:z.{decimals}f}", f"{std:.{decimals}f}"
    return f"{value:.3g}", f"{std:.2g}"


def displayed(quantity: Quantity, name: str = "") -> tuple[float, float, str]:
    """Return the value, standard deviation and unit in the display unit."""
    factor, unit = shown_in(quantity.unit, name)
    return factor * quantity.value, factor * quantity.std, unit


def rounded_text(value: float, std: float) -> str:
    """Return the value up to the first digit of its sigma, with at most three digits."""
    if not determined(value, std):
        return f"{value:.2g}"
    decimals = max(0, -math.floor(math.log10(std)))
    if value:
        decimals = min(decimals, max(0, 2 - math.floor(math.log10(abs(value)))))
    return f"{value:.{decimals}f}"


def determined(value: float, std: float) -> bool:
    """Return whether a value is determined: its sigma is not huge compared with it."""
    return 0.0 < std < math.inf and (std < 1e3 * abs(value) or (abs(value) < 1e-3 and std < 1.0))


def span_text(low: float, high: float) -> str:
    """Return two limits, such as ``"-4.40 to 3.82"``; the larger one has three digits."""
    largest = max(abs(low), abs(high))
    decimals = max(0, 2 - math.floor(math.log10(largest))) if largest > 0.0 else 0
    return f"{low:z.{decimals}f} to {high:z.{decimals}f}"


# ---- Numbers and single lines on the terminal

# A time constant so many sigmas below zero is reported as a growing mode.
GROWING_MODE_SIGMAS = 2.0


class EscapingConsole(Console):
    """A console that escapes control characters in texts but keeps its own styles."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Yield the printed segments with escaped texts."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=escaped(segment.text))


def console() -> Console:
    """Return a console for the standard output; 120 columns wide if that is not a terminal.

    Brackets in texts are not read as styles.
    """
    plain = EscapingConsole(file=styled_stream(sys.stdout), markup=False)
    return (
        plain
        if plain.is_terminal
        else Console(width=120, no_color=True, highlight=False, markup=False)
    )


def as_text(show: Callable[[Console], None]) -> str:
    """Return the text that ``show`` prints if the output is not a terminal, without trailing
    blanks.
    """
    out = Console(file=io.StringIO(), width=120, no_color=True, highlight=False, markup=False)
    show(out)
    return "".join(f"{line.rstrip()}\n" for line in out.file.getvalue().splitlines())  # type: ignore[attr-defined]


def number_text(value: float, std: float | None = None) -> str:
    """Return a number with two digits of its standard deviation, or five digits without one."""
    if not math.isfinite(value):
        return "unknown"
    if std is None or not 0 < std < math.inf:
        return f"{value:.5g}"
    last = math.floor(math.log10(std)) - 1  # decimal place of the second digit of the sigma
    if last >= -7:
        return f"{value:z.{max(0, -last)}f}"
    return f"{value:.{max(1, math.floor(math.log10(max(abs(value), std))) - last)}e}"


def derived_line(derived: Mapping[str, tuple[float, float]]) -> str:
    """Return derived quantities, such as natural frequencies, with their sigmas in one line."""
    return "; ".join(_derived_text(key, value, std) for key, (value, std) in derived.items())


def _derived_text(key: str, value: float, std: float) -> str:
    """Return ``"phugoid frequency 0.0881 +- 0.0012 rad/s (0.014 Hz)"``.

    A negative time constant is followed by the doubling time of the growing mode.
    """
    unit = "" if "damping" in key else " s" if key.endswith(("delay", "constant")) else " rad/s"
    grows = (
        f" (grows, doubled after {-value * math.log(2.0):.3g} s)"
        if key.endswith("time_constant") and value < -GROWING_MODE_SIGMAS * std
        else ""
    )
    words = key.replace("_", " ").replace("dutch", "Dutch")
    if not determined(value, std):
        return f"{words} not determined"
    return (
        f"{words} {number_text(value, std)} +- "
        f"{number_text(std, std)}{unit}{in_hertz(value, key, unit.strip())}{grows}"
    )


def test_line(tests: Sequence[ResidualTest]) -> str:
    """Return the residual tests in one line: failing outputs with axes, then axes that pass."""
    failed = [test for test in tests if not test.passed]
    if not tests:
        return ""
    if not failed:
        p_values = "; ".join(f"{test.channel}: p-value {test.p_value:.2g}" for test in tests)
        limit = f"a test fails below {WHITENESS_P_VALUE:g}"
        return f"residual: consistent with noise ({p_values}; {limit})"
    axes = list(dict.fromkeys(AXES[test.channel] for test in tests if test.channel in AXES))
    several = len(axes) > 1
    # Channels without an axis come last.
    failed.sort(key=lambda test: [*axes, AXES.get(test.channel)].index(AXES.get(test.channel)))
    sentences: dict[str, list[str]] = {}
    for test in failed:
        axis = AXES.get(test.channel) if several else None
        channel = f"{test.channel} ({axis})" if axis else test.channel
        sentences.setdefault(channel, []).append(test.sentence)
    parts = [f"{channel}: {', '.join(found)}" for channel, found in sentences.items()]
    failed_axes = {AXES.get(test.channel) for test in failed}
    sound = [axis for axis in axes if axis not in failed_axes] if several else []
    return "residual is more than noise (residual: measured minus predicted): " + "; ".join(
        [*parts, *([f"consistent with noise in {listed(sound)}"] if sound else [])]
    )


def listed(words: Sequence[str]) -> str:
    """Return words as ``"a, b and c"``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
