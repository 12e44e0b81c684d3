"""Formats of figures, figures of a page by name, and their captions; loads no plotting library."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.report.plot_data import PlotData

# ---- In which formats figures are written

Formats = tuple[str, ...]

PNG, SVG, PDF = "png", "svg", "pdf"
FORMATS: Formats = (PNG, SVG, PDF)
NONE = "none"
USUAL: Formats = (PNG,)


def formats_wanted(figures: bool | str | Sequence[str]) -> Formats:
    """Return the same from Python: True for the usual format, False for none, or names of formats.
    Raises DeclarationError as ``formats_of``.
    """
    if isinstance(figures, bool):
        return USUAL if figures else ()
    return formats_of([figures] if isinstance(figures, str) else list(figures) or [NONE])


def formats_of(asked: Sequence[str] | None, none: bool = False) -> Formats:
    """Return the formats that are asked for, in the order of ``FORMATS``: each text names one or
    several with commas between; None is ``USUAL``.

    ``none``, in the texts or as the second argument, asks for no figure. Raises DeclarationError
    for another name, for ``none`` beside a format and for no name at all.
    """
    names = [name.strip().lower() for text in asked or () for name in text.split(",")]
    remedy = (
        f"name {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, several with commas between, or {NONE}"
    )
    for name in names:
        if name not in (*FORMATS, NONE):
            raise DeclarationError(
                f"{name!r} is no format of a figure" if name else "no format is named",
                where="--figures",
                remedy=remedy,
            )
    wanted = set(names) - {NONE}
    if wanted and (none or NONE in names):
        raise DeclarationError(
            f"no figures, and figures as {' and '.join(sorted(wanted))}",
            where="--figures",
            remedy="ask for one of the two",
        )
    if none or NONE in names:
        return ()
    return tuple(name for name in FORMATS if name in wanted) if asked else USUAL


# ---- A figure of a page as text; nothing here loads the plotting library


@dataclass(frozen=True)
class Drawn:
    """A figure of a page: the ``stem`` of its files, the SVG element, a caption, and its data where
    the page can draw it from them.
    """

    stem: str
    svg: str
    caption: str
    plot: PlotData | None = field(default=None, compare=False)


# ---- One sentence below each figure of a page, by the stem of its file

CAPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "record": "The record: inputs and outputs",
        "fit": "Recorded and estimated outputs, with the residuals",
        "held_out": (
            "Recorded and predicted outputs of data that were not fitted, with the residuals"
        ),
        "spectra": "Spectra of recorded and simulated outputs and of what is left",
        "parameters": "Parameters over time with two sigmas",
        "states": "States of the filter over time with two sigmas",
        "innovations": (
            "Innovations with two sigmas, and their autocorrelation with the band of white noise"
        ),
        "correlation": "Correlation of the estimates",
        "poles": "Poles of the estimate, with those that its covariance allows",
        "errors": "Errors of the estimates in sigmas",
        "repeated": "Errors over repeated flights in reported sigmas",
        "determination": "How far this record determines each parameter",
        "flexibility": "Errors against the degree of flexibility",
        "equivalents": "Estimates against true and condensed values",
        "trajectory": "The fall: recorded, true and estimated",
        "ballistic_coefficient": "Ballistic coefficient over time with two sigmas",
        "fit_other": (
            "Recorded against simulated outputs of the study that this one is compared with"
        ),
        "compared": "The two studies side by side",
        "delays": "Likelihood of each delay of the bank",
        "linear": "Flown against the linear loop",
        "margins": "Phase margins that the printed numbers leave open",
        "variants": "The same study with one change at a time",
        "reconstruction": "Recorded outputs and their reconstruction from kinematics",
        "compared_estimates": "Estimates of all studies with two sigmas",
        "compared_errors": "Errors of all studies",
        "compared_responses": "Outputs of all studies over time",
        "normality": "Errors of all parameters against the normal distribution",
        "consistency": "Squared errors and innovations of all runs against chi-square",
        "coverage": "Share of the runs whose interval contains the reference",
        "campaign": (
            "Errors of all runs in their own sigmas, and the share of intervals that hold the "
            "reference"
        ),
        "verdicts": (
            "Verdicts by what was hidden, with the share of right answers and its exact 95 % "
            "interval"
        ),
        "confusion": (
            "What was concluded (along) of what was hidden (up the side), in per cent of its "
            "flights"
        ),
        "reliability": (
            "The share of names that is right against the probability that they were given, with "
            "exact 95 % intervals"
        ),
        "effect_coverage": (
            "The share of effects' parameters within one, two and three reported sigmas of the "
            "truth, flights resampled whole"
        ),
        "maneuvers": (
            "Inputs and expected responses of every maneuver, the best first, with the limits"
        ),
        "effects": ("Effects by flight. Filled: has it; grey: undecided; open: does not have it"),
        "shared": "What each flight says of a shared value by itself, and the common value",
        "over": (
            "Derivatives of all flights over the condition, with the common line and the scatter "
            "between flights"
        ),
        "flight": ("The whole flight: inputs and motion, maneuvers shaded, trim points grey"),
        "response": (
            "Magnitude, phase and coherence over frequency, with 95 % bands; grey: outside the "
            "usable band"
        ),
        "mismatch": (
            "The estimated response over the fitted one, between the envelopes of dynamics that a "
            "pilot does not notice"
        ),
        "bandwidth": (
            "The attitude response with its phase and gain bandwidth and its phase delay, spans of "
            "95 %"
        ),
        "coherence": (
            "Coherence of every response that is expected of one flight, over frequency; dotted: "
            "the limit of a usable one"
        ),
        "loop": (
            "The broken-loop response with its gain and phase margins, and its distance from -1, "
            "spans of 95 %"
        ),
        "tolerances": (
            "The prediction in the band that a test of simulator qualification allows about the "
            "measured channel"
        ),
        "forces": "Force coefficients of each maneuver, measured and by the terms that were chosen",
        "moments": (
            "Moment coefficients of each maneuver, measured and by the terms that were chosen"
        ),
        "prediction": "Measured and predicted outputs, with the residuals",
        "watched": "Parameters while the stream arrived",
        "history": "Margins while the stream arrived, with their 95 % intervals",
        "qualities": (
            "Flying qualities on the charts of their criteria, with the regions that hold 95 % and "
            "the limits of the levels"
        ),
        "step": (
            "Step response of the fitted transfer function over its steady value, with its 95 % "
            "band"
        ),
    }
)


def caption_of(stem: str) -> str:
    """Return the caption of ``fit``, ``fit_2`` and ``fit_METHOD`` alike, the number or method
    behind it; the stem in words where there is none.
    """
    known = [name for name in CAPTIONS if stem == name or stem.startswith(f"{name}_")]
    if not known:
        words = stem.replace("_", " ")
        return words[:1].upper() + words[1:]
    name = max(known, key=len)
    rest = stem[len(name) + 1 :].replace("_", " ")
    if not rest:
        return CAPTIONS[name]
    return f"{CAPTIONS[name]} ({f'record {rest}' if re.fullmatch(r'[0-9]+', rest) else rest})"
