"""Quantities with their sigmas in the unit in which people read them."""

from __future__ import annotations

import math

from ident.tracing.diagnosis import Quantity
from scenarios.terminal.display_units import in_hertz, shown_in, spaced

# Channels in words; one that is its own word, such as the airspeed or the rudder, is not here.
CHANNELS = {
    **{"alpha": "angle of attack", "q": "pitch rate", "nz": "load factor", "theta": "pitch attitude", "nx": "axial load factor"},
    **{"beta": "angle of sideslip", "p": "roll rate", "r": "yaw rate", "phi": "bank angle", "ny": "lateral load factor"},
}


# Which equation of motion a channel is measured along.
AXES = {
    **{"airspeed": "speed", "nx": "speed", "alpha": "lift", "nz": "lift", "q": "pitch", "theta": "pitch"},
    **{"beta": "side force", "ny": "side force", "p": "roll", "phi": "roll", "r": "yaw"},
}

UNDETERMINED = "not determined by these data"


def with_sigma(quantity: Quantity, unit: str | None = None, name: str = "") -> str:
    """``"0.061 +- 0.001 s"``, angles in degrees, frequencies in rad/s and Hz, digits by the sigma; ``unit`` replaces the quantity's own."""
    value, std, text = displayed(quantity, name)
    if name == "count":  # of events: a whole number
        return f"{value:.0f}"
    told = value_text(value, std, text if unit is None else unit) if determined(value, std) else UNDETERMINED
    return told + in_hertz(value, name, text) if determined(value, std) else told


def value_text(value: float, std: float, unit: str = "") -> str:
    """``"0.061 +- 0.001 s"``; a sigma that says nothing is told as such, one of zero is that of a value at its bound."""
    shown = spaced(unit)
    if std == 0.0 and value != 0.0:
        return f"{value:.5g}{shown} (bound)"
    if not determined(value, std):
        return "not determined"
    digits = _digits(std)
    return f"{value:.{digits}f} +- {std:.{digits}f}{shown}" if digits < 7 else f"{value:.3g} +- {std:.2g}{shown}"


def displayed(quantity: Quantity, name: str = "") -> tuple[float, float, str]:
    """Value, standard deviation and unit as people read them: plain angles and their rates in degrees, frequencies in rad/s."""
    factor, unit = shown_in(quantity.unit, name)
    return factor * quantity.value, factor * quantity.std, unit


def _number(value: float, std: float) -> str:
    """The value with the digits that its sigma leaves, three at most."""
    if not determined(value, std):
        return f"{value:.2g}"
    digits = max(0, -math.floor(math.log10(std)))
    return f"{value:.{min(digits, max(0, 2 - math.floor(math.log10(abs(value))))) if value else digits}f}"


def _digits(std: float) -> int:
    """Decimals that show two digits of a sigma that begins with 1, else one."""
    power = math.floor(math.log10(std))
    return max(0, -power + (1 if std / 10.0**power < 1.95 else 0))


def determined(value: float, std: float) -> bool:
    """Whether a sigma leaves anything of a value: a hundred times the angle that a limit has is no knowledge of it."""
    return 0.0 < std < math.inf and (std < 1e3 * abs(value) or (abs(value) < 1e-3 and std < 1.0))
