"""Figures of results: functions that take a result and return a matplotlib Figure.

They are the figures of study folders.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from scenarios.api.shown import file_given
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.compatibility import CompatibilityCheck
    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.identification.identify import Identified
    from scenarios.maneuvers import FoundManeuvers
    from scenarios.responses.analysis import ResponseEstimates
    from sim import record as sim_record


Inner_co = TypeVar("Inner_co", covariant=True)


class ResultOf(Protocol[Inner_co]):
    """A result with the complete internal result of type ``Inner_co``."""

    @property
    def details(self) -> Inner_co: ...


if TYPE_CHECKING:
    FittedResult = ResultOf[Identified]
    SimulatedStudy = ResultOf[Any]
    DiagnosisResult = ResultOf[Tracing]
    CheckResult = ResultOf[CompatibilityCheck]
    ManeuverResult = ResultOf[FoundManeuvers]
    ResponseResult = ResultOf[ResponseEstimates]


class RecordChannels(Protocol):
    """Channels in SI by name, their units, and which of them are inputs."""

    @property
    def name(self) -> str: ...
    @property
    def hold(self) -> str: ...
    @property
    def time(self) -> np.ndarray: ...
    @property
    def units(self) -> dict[str, str]: ...
    @property
    def input_names(self) -> tuple[str, ...]: ...
    @property
    def output_names(self) -> tuple[str, ...]: ...
    def __getitem__(self, name: str, /) -> np.ndarray: ...


def maneuvers(found: ManeuverResult) -> Figure:
    """Plot the whole flight with its maneuvers marked by their numbers, angles in degrees."""
    from scenarios.plots.maneuvers import figure_flight

    return shown(figure_flight(found.details, found.details.identity.name))


def response(found: ResponseResult, number: int = 0) -> Figure:
    """Plot magnitude, phase and coherence of a frequency response.

    ``number`` counts the responses from 0, outputs first.
    """
    from scenarios.plots.flying_qualities import figure_response
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_response(found.details, row, column))


def mismatch(found: ResponseResult, number: int = 0) -> Figure:
    """Plot a frequency response over its fitted transfer function.

    The figure has the envelopes of dynamics that a pilot does not notice.
    """
    from scenarios.plots.flying_qualities import figure_mismatch
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_mismatch(found.details, row, column))


def bandwidth(found: ResponseResult, number: int = 0) -> Figure:
    """Plot an attitude response with its bandwidths and phase delay.

    ``number`` counts the responses with a bandwidth from 0.
    """
    from scenarios.plots.flying_qualities import figure_bandwidth

    return shown(figure_bandwidth(found.details, number))


def qualities(found: ResponseResult, number: int = 0) -> Figure:
    """Plot flying qualities of a response on the charts of their criteria, with levels.

    ``number`` counts the responses with a chart from 0.
    """
    from scenarios.plots.flying_qualities import figure_qualities

    return shown(figure_qualities(found.details, number))


def step(found: ResponseResult, number: int = 0) -> Figure:
    """Plot the step response of a fitted response over its steady value.

    ``number`` counts the responses from 0, outputs first.
    """
    from scenarios.plots.flying_qualities import figure_steps
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_steps(found.details, row, column))


def loop(found: ResponseResult) -> Figure:
    """Plot a broken-loop response with its stability margins."""
    from scenarios.plots.flying_qualities import figure_margins

    return shown(figure_margins(found.details))


def record(given: RecordChannels) -> Figure:
    """Plot inputs and outputs against time, angles in degrees."""
    from scenarios.plots.signals import figure_record

    return shown(figure_record(_as_recorded(given), given.name))


def fit(found: FittedResult | SimulatedStudy, number: int = 0) -> Figure:
    """Plot measured and predicted outputs, and the residual below each.

    ``number`` counts the fitted records from 0. The figure of a simulated flight has the true
    outputs, too.
    """
    from scenarios.identification.identify import Identified
    from scenarios.plots.signals import figure_fit, response_of

    if not isinstance(found.details, Identified):
        study = found.details
        responses = [
            response_of(method.result.estimate, method.estimation.label)
            for method in study.methods[:1]
        ]
        return shown(
            figure_fit(
                study.record, responses, study.truth, study.scenario.title, study.truth.noise_std
            )
        )
    inner = found.details.found
    records, estimate = (inner.record, *inner.others), inner.estimate
    given = _one_of(records, number, "fitted records")
    noise = dict(zip(estimate.output_names, estimate.noise_std.tolist(), strict=True))
    return shown(
        figure_fit(
            given,
            [response_of(estimate, record=number)],
            None,
            f"{given.name}: {inner.vehicle.model}, {inner.method}",
            noise,
        )
    )


def held_out(found: FittedResult, number: int = 0) -> Figure:
    """Plot measured and predicted outputs of a held-out record.

    ``number`` counts the held-out records from 0.
    """
    from scenarios.plots.signals import MethodOutputs, figure_fit

    inner = found.details.found
    predicted = [fit for fit in inner.fits if fit.held_out and fit.figures is not None]
    fit = _one_of(predicted, number, "records held out")
    noise = dict(zip(inner.estimate.output_names, inner.estimate.noise_std.tolist(), strict=True))
    outputs = dict(zip(fit.outputs, fit.simulated, strict=True))
    title = f"{fit.record.name}: {inner.vehicle.model}, {inner.method}\nheld out"
    response = MethodOutputs("free simulation", outputs)
    return shown(figure_fit(fit.record, [response], None, title, noise))


def correlation(found: FittedResult) -> Figure:
    """Plot the correlations of the estimates."""
    from scenarios.plots.estimates import figure_correlation

    inner = found.details.found
    return shown(
        figure_correlation(
            inner.estimate.names,
            inner.estimate.correlation,
            f"{inner.vehicle.model}, {inner.method}",
        )
    )


def residuals(found: DiagnosisResult, number: int = 0) -> Figure:
    """Plot the residuals of a fitted record, before and after.

    ``number`` counts the fitted records from 0.
    """
    return _of_diagnosis(found, "residuals", number)


def spectra(found: DiagnosisResult, number: int = 0) -> Figure:
    """Plot the spectra of the residuals of a fitted record, before and after."""
    return _of_diagnosis(found, "spectra", number)


def prediction(found: DiagnosisResult, number: int = 0) -> Figure:
    """Plot measured and predicted outputs of a held-out record, before and after."""
    return _of_diagnosis(found, "held_out", number)


def evidence(found: DiagnosisResult) -> Figure:
    """Plot the best candidates of each round of the search."""
    return _of_diagnosis(found, "evidence", 0)


def derivatives(found: DiagnosisResult) -> Figure:
    """Plot the parameters of the declared model, before and after."""
    return _of_diagnosis(found, "derivatives", 0)


def replication(found: DiagnosisResult) -> Figure:
    """Plot the parameters of the claimed effects by each record alone."""
    return _of_diagnosis(found, "replication", 0)


def reconstruction(found: CheckResult, number: int = 0) -> Figure:
    """Plot measured channels and their reconstruction by kinematics."""
    from scenarios.plots.signals import figure_reconstruction

    item = _one_of(found.details.result.reconstructions, number, "reconstructions")
    return shown(figure_reconstruction(item, f"{item.record}: reconstructed against measured"))


class Figures:
    """The figures of one result: ``found.plot.fit()`` is ``flightid.plot.fit(found)``."""

    def __init__(self, of: Any, *functions: Callable[..., Figure]) -> None:
        self._of = of
        self._functions = {function.__name__: function for function in functions}

    def __getattr__(self, name: str) -> Callable[..., Figure]:
        functions = self.__dict__.get("_functions", {})
        if name not in functions:
            raise AttributeError(f"there is no figure {name!r}: {', '.join(functions)}")
        return partial(functions[name], self._of)

    def __dir__(self) -> list[str]:
        return list(self._functions)

    def __repr__(self) -> str:
        return f"<figures: {', '.join(self._functions)}>"


class Interactive:
    """A figure for notebooks with zoom, values under the pointer, and curves that can be hidden.

    Drag to zoom; double click to show everything.

    Attributes
    ----------
    html : the figure as one HTML document, which works offline.
    """

    def __init__(self, html: str, words: str) -> None:
        self.html = html
        self._words = words

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the document; returns its path."""
        target = file_given(path)
        target.write_text(self.html, encoding="utf-8", newline="\n")
        return target

    def __repr__(self) -> str:
        return f"<Interactive: {self._words:.80}>"

    def _repr_html_(self) -> str:
        from scenarios.plots.drawing import figure_frame

        return figure_frame(self.html, self._words, height=480)


def interactive(figure: Figure, words: str = "") -> Interactive:
    """Return a figure that zooms in a notebook. Bars, error bars and maps stay a drawing.

    Parameters
    ----------
    figure : figure of this module, or of matplotlib with lines, points and bands.
    words : description for readers who cannot see it; empty: from its axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure()
    >>> _ = figure.subplots().plot([0.0, 1.0, 2.0], [0.0, 1.0, 0.5])
    >>> interactive(figure, "a triangle")
    <Interactive: a triangle>
    """
    from scenarios.plots.drawing import description, figure_document

    words = words or description(figure)
    return Interactive(figure_document(figure, words), words)


def shown(figure: Figure) -> Figure:
    """Return a figure that a notebook shows without a matplotlib backend."""
    from scenarios.plots.drawing import figure_png

    figure._repr_png_ = partial(figure_png, figure)  # type: ignore[attr-defined]
    return figure


def _of_diagnosis(found: DiagnosisResult, stem: str, number: int) -> Figure:
    from scenarios.diagnosis.files import figures_of as made
    from scenarios.diagnosis.files import numbered, pictured

    figures = dict(made(pictured(found.details)))
    name = numbered(stem, number)
    if name not in figures:
        raise DeclarationError(
            f"there is no figure {name}",
            where="plot",
            remedy=f"this diagnosis has {', '.join(figures)}",
        )
    return shown(figures[name]())


def _one_of(items: Any, number: int, what: str) -> Any:
    if not 0 <= number < len(items):
        raise DeclarationError(
            f"there is no number {number}",
            where=f"plot, {what}",
            remedy=f"there are {len(items)}, from 0 on",
        )
    return items[number]


def _as_recorded(given: RecordChannels) -> sim_record.Record:
    """Return an internal record with all channels, as inputs and outputs."""
    from sim.record import Channel, Hold
    from sim.record import Record as SimRecord

    inputs, outputs = (
        tuple(
            Channel.of(name, given.units[name], given[name])
            for name in names
            if np.any(np.isfinite(given[name]))
        )
        for names in (given.input_names, given.output_names)
    )
    return SimRecord(given.time, inputs, outputs, Hold(given.hold), given.name)
