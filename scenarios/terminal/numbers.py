"""Numbers and single lines as the terminal shows them."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from ident.statistics.residuals import ResidualTest
from scenarios.files.escaping import escaped, styled_stream
from scenarios.terminal.display_units import in_hertz
from scenarios.terminal.quantities import AXES, determined

GROWING = 2.0  # sigmas of a time constant below zero, from which a mode is said to grow


class EscapingConsole(Console):
    """A console whose own styles reach the terminal, and no control character of a text (rich asks for a class here)."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments of what is printed, their texts escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=escaped(segment.text))


def console(width: int | None = None) -> Console:
    """A console that never folds numbers, 120 columns where the output is not a terminal; brackets in texts stay as they are."""
    plain = EscapingConsole(file=styled_stream(sys.stdout), markup=False)
    return plain if plain.is_terminal else Console(width=width or 120, no_color=True, highlight=False, markup=False)


def as_text(show: Callable[[Console], None]) -> str:
    """What ``show`` prints, as it stands where the output is not a terminal, without blanks at the ends of lines."""
    out = Console(file=io.StringIO(), width=120, no_color=True, highlight=False, markup=False)
    show(out)
    return "".join(f"{line.rstrip()}\n" for line in out.file.getvalue().splitlines())  # type: ignore[attr-defined]


def number(value: float, std: float | None = None) -> str:
    """A number with the digits that its standard deviation makes sensible: two of the deviation, else five."""
    if not math.isfinite(value):
        return "unknown"
    if std is None or not 0 < std < math.inf:
        return f"{value:.5g}"
    from math import floor, log10

    last = floor(log10(std)) - 1  # the decimal place of the deviation's second digit
    if last >= -5:
        return f"{value:.{max(0, -last)}f}"
    return f"{value:.{max(1, floor(log10(max(abs(value), std))) - last)}e}"


def derived_line(derived: Mapping[str, tuple[float, float]]) -> str:
    """Natural frequency, damping and the like with their sigmas, in one line."""
    return "; ".join(_derived_text(key, value, std) for key, (value, std) in derived.items())


def _derived_text(key: str, value: float, std: float) -> str:
    """``"phugoid frequency 0.0881 +- 0.0012 rad/s (0.014 Hz)"``; a time constant that is negative is that of a mode that grows."""
    unit = "" if "damping" in key else " s" if key.endswith(("delay", "constant")) else " rad/s"
    grows = f" (grows, doubled after {-value * math.log(2.0):.3g} s)" if key.endswith("time_constant") and value < -GROWING * std else ""
    words = key.replace("_", " ").replace("dutch", "Dutch")
    if not determined(value, std):
        return f"{words} not determined"
    return f"{words} {number(value, std)} +- {number(std, std)}{unit}{in_hertz(value, key, unit.strip())}{grows}"


def test_line(tests: Sequence[ResidualTest]) -> str:
    """What the residual tests say, in one line: which outputs fail, in which axis where there are several, and which axes are sound."""
    failed = [test for test in tests if not test.passed]
    if not failed:
        return "residual: what the noise alone would give (" + "; ".join(f"{t.channel} p = {t.p_value:.2g}" for t in tests) + ")" if tests else ""
    axes = dict.fromkeys(AXES[test.channel] for test in tests if test.channel in AXES)
    if len(axes) < 2:
        return "residual is not the noise alone: " + "; ".join(f"{test.channel}: {test.sentence}" for test in failed)
    wrong = {axis: [test for test in failed if AXES.get(test.channel) == axis] for axis in axes}
    told = [f"in {axis} ({', '.join(f'{test.channel} {test.sentence}' for test in some)})" for axis, some in wrong.items() if some]
    told += [f"{test.channel}: {test.sentence}" for test in failed if test.channel not in AXES]
    sound = [axis for axis, some in wrong.items() if not some]
    return f"residual is not the noise alone: {'; '.join(told)}{f'; noise alone in {_listed(sound)}' if sound else ''}"


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
