"""Formats of figures, figures of a page, and their captions. It loads no plotting library."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.report.plot_data import PlotData

# ---- Formats of the files of a figure

Formats = tuple[str, ...]

PNG, SVG, PDF = "png", "svg", "pdf"
FORMATS: Formats = (PNG, SVG, PDF)
NONE = "none"  # requests no figure
USUAL: Formats = (PNG,)


def formats_wanted(figures: bool | str | Sequence[str]) -> Formats:
    """Return the formats that a Python call requests: True for the usual one, False for none, or
    names of formats. Raise DeclarationError as ``formats_of``.
    """
    if isinstance(figures, bool):
        return USUAL if figures else ()
    names = [figures] if isinstance(figures, str) else figures
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        remedy = f"give True, False, or names of formats: {', '.join(FORMATS)}"
        raise DeclarationError(f"{figures!r:.60} names no format", where="figures", remedy=remedy)
    return formats_of([*names] or [NONE])


def formats_of(texts: Sequence[str] | None, none: bool = False) -> Formats:
    """Return the requested formats, in the order of ``FORMATS``.

    Parameters
    ----------
    texts : each names one or several formats, separated by commas, or ``NONE``; None requests the
        usual format.
    none : request no figure.

    Raises
    ------
    DeclarationError : a name is unknown or empty, or both a format and no figure are requested.
    """
    names = [name.strip().lower() for text in texts or () for name in text.split(",")]
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
    none = none or NONE in names
    requested = set(names) - {NONE}
    if requested and none:
        raise DeclarationError(
            f"no figures, and figures as {' and '.join(sorted(requested))}",
            where="--figures",
            remedy="ask for one of the two",
        )
    if none:
        return ()
    return tuple(name for name in FORMATS if name in requested) if texts else USUAL


# ---- Figures of a page


@dataclass(frozen=True)
class Drawn:
    """A figure of a page.

    Attributes
    ----------
    stem : stem of its files.
    svg : SVG element.
    caption : caption.
    plot : data of an interactive figure; None if it is not interactive.
    """

    stem: str
    svg: str
    caption: str
    plot: PlotData | None = field(default=None, compare=False)


# ---- Captions

# File stem -> caption.
CAPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "record": "The record: inputs and outputs",
        "fit": "Recorded and estimated outputs, with the residuals",
        "held_out": (
            "Recorded and predicted outputs of data that were not fitted, with the residuals"
        ),
        "spectra": "Power spectra of recorded and simulated outputs, and of the residuals",
        "parameters": (
            "Estimate of each parameter over time, with the band of two standard deviations"
        ),
        "states": "States of the filter over time, with the band of two standard deviations",
        "innovations": (
            "Innovations (measured minus predicted outputs) with two standard deviations, and "
            "their autocorrelation with the band that holds 95 % of the values of white noise"
        ),
        "correlation": "Correlation between the estimated parameters",
        "poles": "Poles of the estimated model, and those of models within its uncertainty",
        "errors": "Error of each estimate in reported standard deviations",
        "repeated": (
            "Errors of the estimates over repeated flights, in reported standard deviations"
        ),
        "determination": "How much of each estimate the record determines, and how much the prior",
        "flexibility": "Errors of the estimates over the degree of flexibility of the aircraft",
        "equivalents": (
            "Estimates, true values, and condensed values (those of a rigid aircraft whose "
            "structure follows its loads without lag)"
        ),
        "trajectory": "Altitude and velocity of the fall: recorded, true and estimated",
        "ballistic_coefficient": (
            "Estimate of the ballistic coefficient over time, with the band of two standard "
            "deviations"
        ),
        "fit_other": (
            "Recorded against simulated outputs of the study that this one is compared with"
        ),
        "compared": "Results of the two studies",
        "delays": (
            "Log likelihood of each delay: one Kalman filter for each delay runs on the record"
        ),
        "linear": "Response of the simulated flight, and of the control loop linearised",
        "margins": "Range of the phase margin that agrees with the published, rounded numbers",
        "variants": "Estimates of the same study, each with one setting changed",
        "reconstruction": (
            "Recorded outputs, and the same outputs computed from the other sensors by kinematics"
        ),
        "compared_estimates": "Estimates of all studies, with two standard deviations",
        "compared_errors": "Errors of the estimates of all studies",
        "compared_responses": "Outputs of all studies over time",
        "normality": (
            "Errors of all parameters in reported standard deviations, against the normal "
            "distribution"
        ),
        "consistency": (
            "Normalised squared errors (NEES) and innovations (NIS) of all runs, against the "
            "chi-square distribution that correct sigmas give"
        ),
        "coverage": "Share of the runs whose interval contains the true value, for each parameter",
        "campaign": (
            "Errors of all runs, each in the standard deviation that its run reports, and the "
            "share of two-sigma intervals that contain the true value"
        ),
        "verdicts": (
            "Verdicts for each hidden effect, with the share of right answers and its exact 95 % "
            "interval"
        ),
        "confusion": (
            "Named cause (columns) for each hidden effect (rows), in per cent of the flights with "
            "this effect"
        ),
        "reliability": (
            "Share of named causes that are right, over the probability that was reported for "
            "them, with exact 95 % intervals"
        ),
        "effect_coverage": (
            "Share of the effects' parameters within one, two and three reported standard "
            "deviations of the true value, with intervals by a bootstrap over flights"
        ),
        "maneuvers": (
            "Inputs and expected responses of every maneuver, the best first. Dashed: the limits; "
            "one that lies far beyond the motion is not drawn"
        ),
        "effects": (
            "Effects by flight. Filled: the flight has the effect; light: undecided; open: it does "
            "not"
        ),
        "shared": (
            "Estimate of each shared parameter from each flight alone, and from all flights "
            "together"
        ),
        "over": (
            "Derivatives of all flights over the flight condition, with the common line and the "
            "scatter between flights"
        ),
        "flight": "The whole flight: inputs and motion, maneuvers shaded, trim points grey",
        "response": (
            "Magnitude, phase and coherence over frequency, with 95 % bands; grey: outside the "
            "usable band"
        ),
        "mismatch": (
            "The estimated response over the fitted one, between the envelopes of dynamics that a "
            "pilot does not notice"
        ),
        "bandwidth": (
            "Response of the attitude, with phase bandwidth, gain bandwidth and phase delay; bars:"
            " 95 % intervals"
        ),
        "coherence": (
            "Expected coherence of each response over frequency; dotted: least coherence of a "
            "usable estimate"
        ),
        "loop": (
            "Broken-loop response with gain and phase margins, and its distance from -1; bands and"
            " bars: 95 % intervals"
        ),
        "tolerances": (
            "Prediction, and the band about the measurement that a test of simulator qualification"
            " allows"
        ),
        "forces": (
            "Force coefficients of each maneuver: measured, and computed by the selected terms"
        ),
        "moments": (
            "Moment coefficients of each maneuver: measured, and computed by the selected terms"
        ),
        "prediction": "Measured and predicted outputs, with the residuals",
        "watched": "Estimates of the parameters while the data arrived",
        "history": "Stability margins while the data arrived, with their 95 % intervals",
        "qualities": (
            "Flying qualities on the charts of their criteria, with the regions that hold 95 % and "
            "those limits of levels that are known for the response"
        ),
        "step": (
            "Step response of the fitted transfer function, divided by its steady value, with its "
            "95 % band"
        ),
    }
)


def caption_of(stem: str, methods: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the caption of a figure by its file stem: ``fit``, ``fit_2`` or ``fit_METHOD``.

    The number of a record or the label of a method, from ``methods``, is added in brackets. An
    unknown stem is returned in words.
    """
    matching = [name for name in CAPTIONS if stem == name or stem.startswith(f"{name}_")]
    if not matching:
        words = stem.replace("_", " ")
        return words[:1].upper() + words[1:]
    name = max(matching, key=len)
    suffix = stem[len(name) + 1 :]
    if not suffix:
        return CAPTIONS[name]
    label = methods.get(suffix, suffix.replace("_", " "))
    if re.fullmatch(r"[0-9]+", label):
        label = f"record {label}"
    return f"{CAPTIONS[name]} ({label})"
