"""What figures write at their axes: textbook symbols for names, degrees for radians."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from scenarios.terminal.display_units import NO_UNIT, shown_in


@dataclass(frozen=True)
class DisplayUnit:
    """A unit as a figure shows it: ``shown = factor * value``, and the text in brackets at the axis."""

    text: str
    factor: float = 1.0


POUNDS_PER_SQUARE_FOOT = DisplayUnit("lb/ft²", 0.3048**2 / 0.45359237)
KILOMETRES = DisplayUnit("km", 1e-3)
METRES_PER_SECOND = DisplayUnit("m/s")

# What the samples of a record are called in a figure: that a program made them is said everywhere.
MEASURED_DATA, SIMULATED_DATA = "measured", "simulated record"

_EXPONENTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_POWERS = str.maketrans("234", "²³⁴")
_SIGNALS = {
    **{"alpha": r"$\alpha$", "q": "$q$", "nz": "$n_z$", "theta": r"$\theta$", "airspeed": "$V$", "nx": "$n_x$"},
    **{"beta": r"$\beta$", "p": "$p$", "r": "$r$", "phi": r"$\phi$", "ny": "$n_y$", "psi": r"$\psi$", "height": "height $h$"},
    **{"elevator": r"elevator $\delta_e$", "aileron": r"aileron $\delta_a$", "rudder": r"rudder $\delta_r$"},
    **{"thrust": "thrust $T$", "stick": r"stick $\delta_p$"},
}
_SYMBOLS = {
    "inv_tau": r"$1/\tau$",
    "delay": "$t_d$",
    "delta": r"$\delta$",
    "delta_0": r"$\delta_0$",
    "nz_0": "$n_{z0}$",
    "natural_frequency": r"$\omega_n$",
    "damping_ratio": r"$\zeta$",
}
# Subscripts of a subscript are written on its line: at the size of a tick label they cannot be read.
_ARGUMENTS = {
    **{"alpha": r"\alpha", "q": "q", "de": r"\delta e", "delta": r"\delta", "0": "0", "V": "V"},
    **{"beta": r"\beta", "p": "p", "r": "r", "da": r"\delta a", "dr": r"\delta r"},
}


def display_unit(unit: str, name: str = "") -> DisplayUnit:
    """How a unit of ours is shown, as in every table, with typeset powers; ``name`` tells a frequency from a rate.

    A label of an unknown kind (that of a stick) is kept.
    """
    factor, shown = shown_in(unit, name)
    return DisplayUnit("–" if shown in NO_UNIT else plain(re.sub(r"(?<=[A-Za-z])[234]\b", lambda power: power[0].translate(_POWERS), shown)), factor)


def axis_label(name: str, unit: DisplayUnit) -> str:
    """Symbol and unit, e.g. ``"$q$ (deg/s)"``."""
    return f"{symbol(name)} ({unit.text})"


def symbol(name: str) -> str:
    """The textbook symbol of a signal or parameter in mathtext; a name that has none stays as it is."""
    if name in _SIGNALS or name in _SYMBOLS:
        return _SIGNALS.get(name) or _SYMBOLS[name]
    if name.startswith("bias_"):
        return f"bias of {symbol(name.removeprefix('bias_'))}"
    if found := re.fullmatch(r"(?:(C)([LDmYln])|(L|M))_(\w+)", name):
        argument = _argument(found[4])
        if argument is not None:
            return f"${found[3]}_{{{argument}}}$" if found[3] else f"$C_{{{found[2]}{argument}}}$"
    if found := re.fullmatch(r"Ceta(\d+)_(\w+)", name):
        argument = _argument(found[2])
        if argument is not None:
            return rf"$C^{{\eta {found[1]}}}_{{{argument}}}$"
    if argument := _argument(name):
        return f"${argument}$"
    return plain(name)


def scaled_unit(unit: DisplayUnit, size: float) -> DisplayUnit:
    """The unit with a power of a thousand in front, so that values of this size (in ``unit``) need few digits at an axis."""
    if not (size > 0.0 and math.isfinite(size)) or 0.02 <= size < 2e4:
        return unit
    power = 3 * math.floor(math.log10(size) / 3.0)
    text = "10" + str(power).translate(_EXPONENTS)
    return DisplayUnit(text if unit.text == "–" else f"{text} {unit.text}", unit.factor * 10.0**-power)


def signed(value: float, form: str) -> str:
    """A number with its sign, the minus as long as the plus; ``form`` is what follows the sign, e.g. ``".3g"``."""
    return format(value, f"+{form}").replace("-", "−")


def plain(text: str) -> str:
    """A text as it stands, dollar signs and all."""
    return text.replace("$", r"\$")


def _argument(text: str) -> str | None:
    if found := re.fullmatch(r"(eta|etadot)(\d+)", text):
        return rf"\eta {found[2]}" if found[1] == "eta" else rf"\dot{{\eta}} {found[2]}"
    return _ARGUMENTS.get(text)
