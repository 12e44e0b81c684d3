"""Quantities as people read them: display units, sigmas, numbers and single lines.

| quantity | shown in |
|---|---|
| angles, their rates | deg, deg/s, deg/s2 |
| frequencies | rad/s, with Hz beside |
| derivatives, trims of the equations (L_0, M_0, N_0) and everything else | the unit that it has: 1/rad, rad/s, s, g, m/s |

Inside and in JSON and CSV files everything is SI, load factors in g.
"""  # noqa: E501

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
# rad/s and rad/s2, but shown as derivatives, not as angles: trims, effectiveness of commands, and
# the gain of a transfer function
NOT_ANGLES = ("gain", "L_0", "M_0", "N_0", "L_lat", "M_lon", "N_ped")


class Shown(NamedTuple):
    """How a quantity is shown: ``factor`` times its number, in ``unit``."""

    factor: float
    unit: str


def shown_in(unit: str, name: str = "") -> Shown:
    """Return the display unit; ``name`` distinguishes a frequency (rad/s) from a rate (deg/s)."""
    if unit in DEGREES and name not in NOT_ANGLES and not is_frequency(name, unit):
        return Shown(180.0 / math.pi, DEGREES[unit])
    return Shown(1.0, f"{unit.removesuffix('/s/s')}/s2" if unit.endswith("/s/s") else unit)


def quantity_text(value: float, unit: str, name: str = "") -> str:
    """Return a number without a sigma as it is shown: ``"0.5 deg"``, ``"12 rad/s (1.91 Hz)"``."""
    factor, shown = shown_in(unit, name)
    return f"{factor * value:.5g}{spaced(shown)}{in_hertz(value, name, unit)}"


def is_frequency(name: str, unit: str) -> bool:
    """Return whether a quantity of ``unit`` is a frequency by its name: ``frequency``,
    ``natural_frequency``, ``omega1``.
    """
    return unit == "rad/s" and (
        "frequency" in name or name.rpartition(".")[2].rstrip("0123456789") == "omega"
    )


def in_hertz(value: float, name: str, unit: str) -> str:
    """Return ``" (1.91 Hz)"`` for a frequency in rad/s, else an empty text."""
    return f" ({value / (2.0 * math.pi):.3g} Hz)" if is_frequency(name, unit) else ""


def unit_cell(unit: str) -> str:
    """Return a unit in a column of units: nothing for a pure number."""
    return unit if unit not in NO_UNIT else ""


def spaced(unit: str) -> str:
    """Return a unit after its number: a blank and the unit, nothing for a pure number."""
    return f" {unit}" if unit not in NO_UNIT else ""


# ---- Quantities with their sigmas in display units

# Channels in words; one that is its own word, such as the airspeed or the rudder, is not here.
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


AXES = {  # Which equation of motion a channel is measured along.
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
    """``"0.0610 +- 0.0012 s"``: angles in degrees, frequencies in rad/s and Hz, digits by the
    sigma; ``unit`` replaces the quantity's own.
    """
    value, std, text = displayed(quantity, name)
    if name == "count":  # of events: a whole number
        return f"{value:.0f}"
    shown = (
        value_text(value, std, text if unit is None else unit)
        if determined(value, std)
        else UNDETERMINED
    )
    return shown + in_hertz(value, name, text) if determined(value, std) else shown


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
    digits = _digits(std)
    if digits < 7:
        return f"{value:z.{digits}f}", f"{std:.{digits}f}"
    return f"{value:.3g}", f"{std:.2g}"


def displayed(quantity: Quantity, name: str = "") -> tuple[float, float, str]:
    """Return the value, standard deviation and unit as people read them: plain angles and their
    rates in degrees, frequencies in rad/s.
    """
    factor, unit = shown_in(quantity.unit, name)
    return factor * quantity.value, factor * quantity.std, unit


def _number(value: float, std: float) -> str:
    """Return the value with the digits that its sigma leaves, three at most."""
    if not determined(value, std):
        return f"{value:.2g}"
    digits = max(0, -math.floor(math.log10(std)))
    return f"{value:.{min(digits, max(0, 2 - math.floor(math.log10(abs(value))))) if value else digits}f}"  # noqa: E501


def _digits(std: float) -> int:
    """Decimals that show two digits of a sigma."""
    return max(0, 1 - math.floor(math.log10(std)))


def determined(value: float, std: float) -> bool:
    """Return whether a value is determined: its sigma is not huge compared with it."""
    return 0.0 < std < math.inf and (std < 1e3 * abs(value) or (abs(value) < 1e-3 and std < 1.0))


def span_text(low: float, high: float) -> str:
    """``"-4.40 to 3.82"``: both ends with the decimals that give the larger one three digits."""
    largest = max(abs(low), abs(high))
    digits = max(0, 2 - math.floor(math.log10(largest))) if largest > 0.0 else 0
    return " to ".join(
        f"{end + 0.0 if round(end, digits) else 0.0:.{digits}f}" for end in (low, high)
    )


# ---- Numbers and single lines as the terminal shows them

GROWING_MODE_SIGMAS = 2.0  # a time constant so many sigmas below zero is reported as a growing mode


class EscapingConsole(Console):
    """A console that escapes control characters in texts but keeps its own styles."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Yield the printed segments with escaped texts."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=escaped(segment.text))


def console() -> Console:
    """Return a console that never folds numbers, 120 columns where the output is not a terminal;
    brackets in texts stay as they are.
    """
    plain = EscapingConsole(file=styled_stream(sys.stdout), markup=False)
    return (
        plain
        if plain.is_terminal
        else Console(width=120, no_color=True, highlight=False, markup=False)
    )


def as_text(show: Callable[[Console], None]) -> str:
    """Return the text that ``show`` prints where the output is not a terminal, without blanks at
    the ends of lines.
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
    from math import floor, log10

    last = floor(log10(std)) - 1  # the decimal place of the deviation's second digit
    if last >= -7:
        return f"{value:z.{max(0, -last)}f}"
    return f"{value:.{max(1, floor(log10(max(abs(value), std))) - last)}e}"


def derived_line(derived: Mapping[str, tuple[float, float]]) -> str:
    """Natural frequency, damping and the like with their sigmas, in one line."""
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
    if not failed:
        return (
            "residual: consistent with noise ("
            + "; ".join(f"{t.channel}: p-value {t.p_value:.2g}" for t in tests)
            + f"; a test fails below {WHITENESS_P_VALUE:g})"
            if tests
            else ""
        )
    axes = dict.fromkeys(AXES[test.channel] for test in tests if test.channel in AXES)
    several = len(axes) > 1
    sentences: dict[
        str, list[str]
    ] = {}  # sentences by channel, with its axis where there are several
    for test in sorted(failed, key=lambda test: _place(test.channel, list(axes))):
        axis = AXES.get(test.channel) if several else None
        sentences.setdefault(f"{test.channel} ({axis})" if axis else test.channel, []).append(
            test.sentence
        )
    parts = [f"{name}: {', '.join(some)}" for name, some in sentences.items()]
    wrong = {AXES.get(test.channel) for test in failed}
    sound = [axis for axis in axes if axis not in wrong] if several else []
    return (
        "residual is more than noise (residual: measured minus predicted): "
        f"{'; '.join(parts)}"
        f"{f'; consistent with noise in {_listed(sound)}' if sound else ''}"
    )


def _place(channel: str, axes: Sequence[str]) -> int:
    """Place of a channel's axis among ``axes``; of a channel without one after them all."""
    axis = AXES.get(channel)
    return axes.index(axis) if axis in axes else len(axes)


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
