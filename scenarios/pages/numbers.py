"""What stands in a cell of a page: a number with what belongs to it (sigma, unit, digits), a link, words."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from scenarios.terminal.numbers import number
from scenarios.terminal.quantities import determined
from sim.errors import ModelError

PURE = "1"  # the unit of counts, shares and ratios
UNDETERMINED = "not determined"
_DIGITS = r"(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"
_UNIT = r" (?:%|sigma|deg(?:/s2?)?|rad(?:/s2?)?|m?s|Hz|m(?:/s2?)?|g|kg|N)"
_QUANTITY = re.compile(
    rf"(?:<|> ?|over )?(?P<value>[+-]?{_DIGITS})(?: (?:\+-|±) (?P<sigma>{_DIGITS}))?(?P<unit>{_UNIT})?(?P<mark> ?\*| \(bound\))?"
)  # "<1e-300" and "over +900 %" sort by their number


_BELOW = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9._+-]*/)*[A-Za-z0-9][A-Za-z0-9._+-]*")


@dataclass(frozen=True)
class Number:
    """A value with its standard deviation (None: it has none) in ``unit`` (empty: that of its column or row).

    ``digits`` are behind the point; None takes as many as the sigma makes sensible, five significant ones without it. ``signed`` shows a plus.
    ``shown`` replaces the number on the page, which still sorts by it.

    Raises ModelError for a value or a sigma that is not finite.
    """

    value: float
    sigma: float | None = None
    unit: str = ""
    digits: int | None = None
    signed: bool = False
    shown: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or not (self.sigma is None or math.isfinite(self.sigma)):
            raise ModelError(f"{self.value} +- {self.sigma} is not finite", where="number of a page", remedy="say in words why there is none")

    @property
    def text(self) -> str:
        """As it stands on the page, with its own unit if it has one."""
        if self.shown:
            return self.shown
        sign = "+" if self.signed and self.value >= 0 else ""
        unit = f" {self.unit}" if self.unit not in ("", PURE) else ""
        if self.digits is not None:
            sigma = f" ± {self.sigma:.{self.digits}f}" if self.sigma else ""
            return signs(f"{sign}{self.value:.{self.digits}f}{sigma}{unit}")
        sigma = f" ± {number(self.sigma, self.sigma)}" if self.sigma else ""
        return signs(f"{sign}{number(self.value, self.sigma)}{sigma}{unit}")


@dataclass(frozen=True)
class Link:
    """Words that lead to a file below the page's own folder. Raises ModelError for anything else: a page leads nowhere outside."""

    text: str
    to: str

    def __post_init__(self) -> None:
        if not _BELOW.fullmatch(self.to):
            raise ModelError(f"{self.to!r} is no file below the page", where="link of a page", remedy="give its path from the page's folder")


Cell = Number | Link | str


def estimate(value: float, sigma: float | None, unit: str = "") -> Cell:
    """An estimate, or in words that these data do not determine it."""
    if not math.isfinite(value) or (sigma is not None and not math.isfinite(sigma)):
        return UNDETERMINED
    if sigma is not None and sigma > 0.0 and not determined(value, sigma):
        return UNDETERMINED
    return Number(value, sigma if sigma else None, unit)


def known(value: float | None, digits: int | None = None, *, signed: bool = False, unit: str = "") -> Cell:
    """A number where there is one, else a dash."""
    return "–" if value is None or not math.isfinite(value) else Number(value, None, unit, digits, signed)


def read_cell(text: str) -> Cell:
    """What a printed table says: a finite number (with its sigma, and per cent), else the words."""
    found = _QUANTITY.fullmatch(text.strip())
    if found is None or not math.isfinite(float(found["value"])) or not math.isfinite(float(found["sigma"] or 0.0)):
        return signs(text) if text.strip() not in ("-", "") else ("–" if text.strip() else "")
    value, sigma = float(found["value"]), found["sigma"]
    unit = (found["unit"] or "").strip().replace("sigma", "σ")
    return Number(value, float(sigma) if sigma else None, unit, shown=signs(text.strip().replace(" sigma", " σ")))


def signs(text: str) -> str:
    """Signs as they are printed in books."""
    text = text.replace("+-", "±").replace("->", "→").replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)
