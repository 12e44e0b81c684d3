"""Figures of results: functions that take a result and return a matplotlib Figure, the same figures
that studies hold.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from scenarios.api.shown import file_given
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scenarios.compatibility.check import CompatibilityCheck
    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.identification.identify import Identified
    from scenarios.maneuvers import FoundManeuvers
    from scenarios.responses.analysis import ResponseEstimates
    from sim import record as sim_record


class Fitted(Protocol):
    """An identification."""

    @property
    def details(self) -> Identified: ...


class Simulated(Protocol):
    """A study of simulated flights."""

    @property
    def details(self) -> Any: ...


class Traced(Protocol):
    """A diagnosis."""

    @property
    def details(self) -> Tracing: ...


class Checked(Protocol):
    """A check of the kinematics."""

    @property
    def details(self) -> CompatibilityCheck: ...


class Found(Protocol):
    """The maneuvers of a record."""

    @property
    def details(self) -> FoundManeuvers: ...


class Responding(Protocol):
    """Frequency responses of records."""

    @property
    def details(self) -> ResponseEstimates: ...


class Recorded(Protocol):
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


def maneuvers(found: Found) -> Figure:
    """Return the whole flight with its maneuvers marked by their numbers, angles in degrees."""
    from scenarios.plots.maneuvers import figure_flight

    return shown(figure_flight(found.details, found.details.identity.name))


def response(found: Responding, number: int = 0) -> Figure:
    """Magnitude, phase and coherence of a frequency response; ``number`` counts the responses from
    0, outputs first.
    """
    from scenarios.plots.flying_qualities import figure_response
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_response(found.details, row, column))


def mismatch(found: Responding, number: int = 0) -> Figure:
    """Return a frequency response over its fitted transfer function, between the envelopes of
    dynamics that a pilot does not notice.
    """
    from scenarios.plots.flying_qualities import figure_mismatch
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_mismatch(found.details, row, column))


def bandwidth(found: Responding, number: int = 0) -> Figure:
    """Return an attitude response with its bandwidths and phase delay; ``number`` counts those that
    have one from 0.
    """
    from scenarios.plots.flying_qualities import figure_bandwidth

    return shown(figure_bandwidth(found.details, number))


def qualities(found: Responding, number: int = 0) -> Figure:
    """Flying qualities of a response on the charts of their criteria, with levels; ``number``
    counts those that have a chart from 0.
    """
    from scenarios.plots.flying_qualities import figure_qualities

    return shown(figure_qualities(found.details, number))


def step(found: Responding, number: int = 0) -> Figure:
    """Return the step of a fitted response over its steady value; ``number`` counts the responses
    from 0, outputs first.
    """
    from scenarios.plots.flying_qualities import figure_steps
    from scenarios.responses.analysis import pairs

    row, column, _ = _one_of(pairs(found.details), number, "responses")
    return shown(figure_steps(found.details, row, column))


def loop(found: Responding) -> Figure:
    """Return a broken-loop response with its stability margins."""
    from scenarios.plots.flying_qualities import figure_margins

    return shown(figure_margins(found.details))


def record(given: Recorded) -> Figure:
    """Inputs and outputs against time, angles in degrees."""
    from scenarios.plots.signals import figure_record

    return shown(figure_record(_as_recorded(given), given.name))


def fit(found: Fitted | Simulated, number: int = 0) -> Figure:
    """Measured outputs against the model's, and the residual below each; ``number`` counts the
    fitted records from 0.

    Of a study of simulated flights with what is true.
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


def held_out(found: Fitted, number: int = 0) -> Figure:
    """Return a record that was not fitted: measured outputs against the model's; ``number`` counts
    these records from 0.
    """
    from scenarios.plots.signals import MethodOutputs, figure_fit

    inner = found.details.found
    one = _one_of(
        [each for each in inner.fits if each.held_out and each.figures is not None],
        number,
        "records held out",
    )
    noise = dict(zip(inner.estimate.output_names, inner.estimate.noise_std.tolist(), strict=True))
    response = MethodOutputs("free simulation", dict(zip(one.outputs, one.simulated, strict=True)))
    return shown(
        figure_fit(
            one.record,
            [response],
            None,
            f"{one.record.name}: {inner.vehicle.model}, {inner.method}\nheld out",
            noise,
        )
    )


def correlation(found: Fitted) -> Figure:
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


def residuals(found: Traced, number: int = 0) -> Figure:
    """Plot the residuals of a fitted record, before and after; ``number`` counts the fitted records
    from 0.
    """
    return _of_diagnosis(found, "residuals", number)


def spectra(found: Traced, number: int = 0) -> Figure:
    """Spectra of the residuals of a fitted record, before and after."""
    return _of_diagnosis(found, "spectra", number)


def prediction(found: Traced, number: int = 0) -> Figure:
    """Return a record that was not fitted: measured and predicted, before and after."""
    return _of_diagnosis(found, "held_out", number)


def evidence(found: Traced) -> Figure:
    """Return the best candidates of each round."""
    return _of_diagnosis(found, "evidence", 0)


def derivatives(found: Traced) -> Figure:
    """Return the parameters of the declared model before and after."""
    return _of_diagnosis(found, "derivatives", 0)


def replication(found: Traced) -> Figure:
    """Return the parameters of the claimed effects from each record by itself."""
    return _of_diagnosis(found, "replication", 0)


def reconstruction(found: Checked, number: int = 0) -> Figure:
    """Measured channels against those that the kinematics reconstruct."""
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
    """A figure that a notebook shows in a frame: drag to zoom, double click to see all, values
    under the pointer, curves that can be switched off.

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
    """Return the figure in a form that zooms in a notebook; one that has bars, error bars or a map
    stays a drawing.

    Parameters
    ----------
    figure : of this module's functions, or any figure of matplotlib with lines, points and bands.
    words : what it shows, for those who do not see it; else what its axes say.

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
    """Return a figure that a notebook shows by itself, also where nobody asked matplotlib for a
    backend.
    """
    from scenarios.plots.drawing import figure_png

    figure._repr_png_ = partial(figure_png, figure)  # type: ignore[attr-defined]
    return figure


def _of_diagnosis(found: Traced, stem: str, number: int) -> Figure:
    from scenarios.diagnosis.report.files import figures_of as made
    from scenarios.diagnosis.report.files import numbered, pictured

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


def _as_recorded(given: Recorded) -> sim_record.Record:
    """Return a record with all its channels, inputs apart."""
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
