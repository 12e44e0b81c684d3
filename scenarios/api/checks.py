"""Examination of records in Python: `check`, `find_maneuvers` and `frequency_response`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.flying_qualities.stability_margins import Margin
from ident.frequency_response import LEAST_COHERENCE
from scenarios import compatibility as checking
from scenarios import maneuvers
from scenarios.api import plot, tables
from scenarios.api.records import ChannelMap, choices_of
from scenarios.api.requests import (
    KEPT,
    ManeuverNames,
    ManeuverParts,
    RecordSource,
    Times,
    file_of,
    plan_from,
    request_of,
    with_parts,
)
from scenarios.api.shown import SavedResult
from scenarios.api.tables import band_of, in_python_words, names_of, with_python_errors
from scenarios.api.vehicle import Vehicle
from scenarios.compatibility_report import finding_lines
from scenarios.files.declarations import read_channel_map
from scenarios.preparation.plan import DeclaredParts
from scenarios.report.figure_formats import Formats
from scenarios.responses import analysis
from scenarios.responses.fitting import FitOptions, ModelOptions
from scenarios.responses.qualities import LevelOptions, levels_by_name, pilot_demand
from scenarios.responses.reading import Names
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import control
    import pandas


# ---- check in Python: sensor faults by kinematics


@dataclass(frozen=True, eq=False, repr=False)
class Check(SavedResult):
    """Sensor faults found by kinematics. ``details``: the complete internal result."""

    details: checking.CompatibilityCheck

    @property
    def findings(self) -> tuple[str, ...]:
        """Names of the accepted sensor faults, such as ``"delay:alpha"``."""
        accepted = (each.name for each in self.details.result.findings if each.supported)
        return tuple(dict.fromkeys(accepted))

    @property
    def sentences(self) -> tuple[str, ...]:
        """Findings and open questions, one sentence each."""
        return tuple(finding_lines(self.details))

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that were used."""
        return tuple(self.details.result.channels)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        return in_python_words((*self.details.look.doubts, *self.details.look.set_aside))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the preparation of the records, one sentence each."""
        return (*self.details.notes, *self.details.result.notes)

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.compatibility_report import print_check
        from scenarios.report.quantities import as_text

        return as_text(lambda out: print_check(self.details, out, KEPT))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per sensor fault, from all records.

        Columns: value and sigma by output error and by the smoother, gain, p, acceptance.
        """
        import pandas

        accepted = set(self.findings)
        rows = [
            {
                "fault": item.name,
                "unit": item.unit,
                "value": item.output_error.value,
                "sigma": item.output_error.std,
                "smoother_value": item.smoother.value,
                "smoother_sigma": item.smoother.std,
                "gain": item.gain,
                "p_value": item.p_value,
                "stands": item.name in accepted,
            }
            for item in self.details.result.joint.estimates
        ]
        columns = ["fault", "unit", "value", "sigma", "smoother_value", "smoother_sigma"]
        columns += ["gain", "p_value", "stands"]
        return pandas.DataFrame(rows, columns=columns).set_index("fault")

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``compatibility.json``."""
        from scenarios.compatibility_report import check_content

        return check_content(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.compatibility_report import write_check

        return write_check(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.reconstruction()``."""
        return plot.Figures(self, plot.reconstruction)

    def __repr__(self) -> str:
        names = ", ".join(record.name for record in self.details.records)
        return f"<Check of {names:.200}: {'; '.join(self.sentences) or 'no fault found':.600}>"

    def _repr_html_(self) -> str:
        names = ", ".join(record.name for record in self.details.records)
        return tables.page(
            f"data compatibility of {names}",
            tables.sentences(self.sentences),
            tables.sentences(self.warnings),
        )


@with_python_errors
def check(
    records: RecordSource | Sequence[RecordSource],
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: ManeuverNames = None,
    maneuvers: ManeuverParts = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    trust_record: bool = False,
) -> Check:
    """Check the sensors by kinematics alone: ``flightid check`` in Python; parameters as in
    ``identify``.

    Raises
    ------
    InputError : records or arguments that cannot be used; a message of one line.

    Examples
    --------
    >>> import flightid as fid
    >>> flight = fid.simulate("trace-vane")
    >>> fid.check(flight.record, flight.vehicle).sentences[0].partition(",")[0]
    'fault found: vane-offset'
    """
    plan = plan_from(start, stop, hold, rate, lowpass, trust_record, columns)
    request = with_parts(
        request_of(records, "", vehicle, channels=channels, plan=plan), maneuver, maneuvers
    )
    return Check(checking.check_files(request))


# ---- maneuvers in Python: the maneuvers in a long record


@dataclass(frozen=True, eq=False, repr=False)
class Maneuvers(SavedResult):
    """The maneuvers of a record. ``details``: the complete internal result."""

    details: maneuvers.FoundManeuvers

    @property
    def parts(self) -> DeclaredParts:
        """Parts of the record to use, for the argument ``maneuvers`` of other functions."""
        return self.details.parts

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        return in_python_words(self.details.cautions)

    def __len__(self) -> int:
        return len(self.details.maneuvers)

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.maneuvers import print_maneuvers
        from scenarios.report.quantities import as_text

        return as_text(lambda out: print_maneuvers(self.details, out, KEPT))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per maneuver, by number.

        Columns: times of the input, part to use, axis, kind, channel, amplitude (SI), t values.
        """
        import pandas

        rows = self.to_dict()["maneuvers"]
        flat = [
            {key: value for key, value in row.items() if key != "excitation"}
            | {f"t_{name}": value for name, value in row["excitation"].items()}
            for row in rows
        ]
        columns = ["number", "name", "start", "end", "from", "to", "axis", "kind"]
        frame = pandas.DataFrame(flat) if flat else pandas.DataFrame(columns=columns)
        return frame.set_index("number")

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``maneuvers.json``."""
        from scenarios.maneuvers import maneuvers_content

        return maneuvers_content(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.maneuvers import write_maneuvers

        return write_maneuvers(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.maneuvers()``."""
        return plot.Figures(self, plot.maneuvers)

    def __repr__(self) -> str:
        return f"<Maneuvers of {self.details.identity.name:.200}: {len(self)}>"

    def _repr_html_(self) -> str:
        rows = [
            [str(m.number), m.name, f"{m.found.start:.2f}", f"{m.found.end:.2f}"]
            for m in self.details.maneuvers
        ]
        table = tables.table(("no.", "maneuver", "start, s", "end, s"), rows, left=2)
        title = f"maneuvers of {self.details.identity.name}"
        return tables.page(title, table, tables.sentences(self.warnings))


@with_python_errors
def find_maneuvers(
    record: RecordSource,
    *,
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    rate: float | None = None,
) -> Maneuvers:
    """Find the maneuvers in a record of any length: ``flightid maneuvers`` in Python.

    Parameters
    ----------
    record : a ``Record``, or whatever ``read_record`` takes.
    channels : a channel map as in ``read_record``.
    columns : names of the columns of a file without a header, in their order.
    rate : rate of a file without a clock, or of the grid of a log's topics, Hz.

    Raises
    ------
    InputError : a record that cannot be searched; a message of one line.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.find_maneuvers(fid.simulate("trace-delay").record)
    <Maneuvers of train: 2>
    """
    chosen = choices_of(channels)
    plan = plan_from(None, None, None, rate, None, False, columns)
    choices = read_channel_map(chosen, surfaces=True) if chosen is not None else None
    return Maneuvers(maneuvers.maneuvers_of(file_of(record), choices, plan))


# ---- response in Python: frequency responses of any record


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(SavedResult):
    """Frequency responses of m outputs to q inputs. ``details``: the complete internal result."""

    details: analysis.ResponseEstimates

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.details.names.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.details.names.outputs

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies in Hz, ``(F,)``."""
        return self.details.responses.frequency

    @property
    def response(self) -> np.ndarray:
        """Complex responses ``(m, q, F)``, in the unit of output over input."""
        return self.details.responses.response

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of the real and of the imaginary part, ``(m, q, F)``."""
        return self.details.responses.std

    @property
    def coherence(self) -> np.ndarray:
        """Multiple coherence ``(m, F)``; of one input its ordinary coherence."""
        return self.details.responses.coherence

    @property
    def usable(self) -> np.ndarray:
        """Whether a frequency is in the usable band, bool ``(m, q, F)``."""
        return self.details.responses.usable

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        return in_python_words(self.details.cautions)

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.report.quantities import as_text
        from scenarios.responses.report import print_responses

        return as_text(lambda out: print_responses(self.details, out, KEPT))

    def to_dataframe(self, output: str | None = None, input: str | None = None) -> pandas.DataFrame:
        """Return the numbers of one response by frequency, with the columns of ``responses.csv``.

        ``output``, ``input`` : names of its signals; default: the first.
        """
        import pandas

        from scenarios.responses.report import response_columns

        columns = response_columns(self.details, *self._places(output, input))
        return pandas.DataFrame(columns).set_index("frequency_Hz")

    def _places(self, output: str | None, input: str | None) -> tuple[int, int]:
        return _place(output, self.outputs, "output"), _place(input, self.inputs, "input")

    def to_control(self) -> control.FrequencyResponseData:
        """Return the responses as python-control's, with the names of the signals, rad/s."""
        return self.details.to_control()

    @property
    def flying_qualities(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Value and standard deviation of every flying quality by response, ``"q/stick"``."""
        return {
            found.name: {name: (q.value, q.std) for name, (q, _) in found.numbers.items()}
            for found in self.details.qualities
        }

    @property
    def margins(self) -> dict[str, dict[str, float]]:
        """Stability margins of all records together, by name such as ``"gain_increase"``.

        Keys: ``value`` and ``std`` (dB, deg, s), ``low`` and ``high`` of the 95 % interval,
        ``frequency`` in rad/s. Empty without a loop.
        """
        loop = self.details.loop
        named = {} if loop is None else loop.margins.named
        return {name: _margin(margin) for name, margin in named.items()}

    @property
    def worst_margins(self) -> dict[str, dict[str, Any]]:
        """Smallest value of each margin over the maneuvers; empty with one maneuver.

        Keys: ``value``, ``half_width`` of the simultaneous interval, ``maneuver``, ``p_alike``.
        """
        from scenarios.responses.loops import margins_content

        loop = self.details.loop
        worst: Any = {} if loop is None else margins_content(loop).get("worst", {})
        return dict(worst)

    @property
    def levels(self) -> dict[str, dict[str, tuple[int, int, int]]]:
        """Levels of each quantity of a fitted form, and of each chart, by response.

        Each is the level (4: outside all), and the best and worst within two standard deviations.
        """
        return levels_by_name(self.details.qualities)

    def to_transfer_function(
        self, output: str | None = None, input: str | None = None, pade: int = 2
    ) -> control.TransferFunction:
        """Return the fitted transfer function of one response for python-control.

        ``output``, ``input`` : names of its signals; default: the first. ``pade`` : order of the
        approximation of its delay; 0 leaves the delay out. Raises InputError if none is fitted.
        """
        import control

        fits = self.details.fits
        places = self._places(output, input)
        fitted = fits.of(*places) if fits is not None else None
        if fitted is None:
            remedy = "name a form (fit)"
            raise DeclarationError(
                "no transfer function is fitted", where="response", remedy=remedy
            )
        function, _ = fitted
        without_delay = control.tf(function.numerator, function.denominator)
        delay = function.values["delay"]
        if pade < 1 or not delay > 0.0:
            return without_delay
        return without_delay * control.tf(*control.pade(delay, pade))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``responses.json``."""
        from scenarios.responses.report import responses_content

        return responses_content(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.responses.report import write_responses

        return write_responses(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.response()``, ``mismatch()``, ``bandwidth()``,
        ``qualities()``, ``step()``, ``loop()``."""
        return plot.Figures(
            self, plot.response, plot.mismatch, plot.bandwidth, plot.qualities, plot.step, plot.loop
        )

    def __repr__(self) -> str:
        names = ", ".join(f"{output}/{name}" for output in self.outputs for name in self.inputs)
        return f"<FrequencyResponse {names:.200}: {self.frequency.size} frequencies>"

    def _repr_html_(self) -> str:
        from scenarios.responses.report import band_sentence

        rows = [
            [name, band_sentence(self.details, row, column)]
            for row, column, name in analysis.pairs(self.details)
        ]
        title = f"frequency responses of {', '.join(self.details.parts[:3])}"
        table = tables.table(("response", "usable band"), rows, left=2)
        return tables.page(title, table, tables.sentences(self.warnings))


@with_python_errors
def frequency_response(
    records: RecordSource | Sequence[RecordSource],
    input: str | Sequence[str],
    output: str | Sequence[str],
    *,
    reference: str | Sequence[str] = (),
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: ManeuverNames = None,
    maneuvers: ManeuverParts = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    band: tuple[float, float] | None = None,
    window: float | Sequence[float] = (),
    tapers: int = 0,
    coherence: float = LEAST_COHERENCE,
    fit: str | Sequence[str] | Mapping[str, str] = (),
    fix: Mapping[str, float] | None = None,
    shared_poles: bool = False,
    bandwidth: str | None = None,
    margins: str | None = None,
    levels: str | None = None,
    airspeed: float | None = None,
    pilot: float | None = None,
    pilot_delay: float | None = None,
    model: str | None = None,
    vehicle: str | PathLike[str] | None = None,
) -> FrequencyResponse:
    """Estimate frequency responses from records: ``flightid response`` in Python.

    Parameters
    ----------
    records : one or several, which are pooled; each a ``Record`` or whatever ``read_record`` takes.
    input, output : names of columns or channels, one or a list. Several inputs give conditioned
        responses.
    reference : for closed loops: external excitations, one for each input.
    channels, columns, start, stop, maneuver, maneuvers, hold, rate, lowpass : as in ``identify``.
    band : lowest and highest frequency, Hz; None: by the windows and the inputs' power.
    window : lengths of the windows, s; default: four lengths.
    tapers : number of sine tapers, used instead of windows.
    coherence : least coherence of the usable band.
    fit : form of a transfer function for every output, or ``{output: form}``: ``"pitch"``,
        ``"roll"``, ``"dutch-roll"``, ``"roll-and-dutch-roll"``, or orders such as ``"1/2"``.
    fix : fixed parameters of the forms.
    shared_poles : one denominator for all.
    bandwidth : kind of outputs, ``"rate"`` or ``"attitude"``: computes bandwidth and phase delay.
    margins : ``"minus"`` or ``"plus"``: computes stability margins of a loop. ``input`` is the
        signal after the summing point, ``output`` the signal fed back with this sign,
        ``reference`` the added excitation.
    levels : aircraft class and flight phase, ``"IV-A"``: computes levels of fitted forms.
    airspeed : m/s: computes n/alpha and CAP of a fitted ``"pitch"``.
    pilot : closed-loop bandwidth of the Neal-Smith pilot, rad/s; needs ``bandwidth``.
    pilot_delay : of that pilot, s; None: 0.25.
    model, vehicle : linear model fitted to all responses, built in or the path of a user's model,
        and its vehicle file. ``fix`` fixes its parameters.

    Raises
    ------
    InputError : records or arguments that cannot be used; a message of one line.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.frequency_response(fid.simulate("uav-sweep").record, "command", "p", reference="sweep")
    <FrequencyResponse p/command: 81 frequencies>
    """
    plan = plan_from(start, stop, hold, rate, lowpass, False, columns)
    request = with_parts(request_of(records, channels=channels, plan=plan), maneuver, maneuvers)
    names = Names(names_of(input), names_of(output), names_of(reference))
    options = analysis.ResponseOptions(band_of(band), _window_lengths(window), tapers, coherence)
    by_output = [f"{k}={v}" for k, v in fit.items()] if isinstance(fit, Mapping) else fit
    fixed = tuple(f"{name}={value}" for name, value in (fix or {}).items())
    found = analysis.responses_of(
        request,
        names,
        options,
        FitOptions(names_of(by_output, "form", "fit"), fixed, shared_poles),
        bandwidth,
        margins,
        LevelOptions(levels, airspeed),
        pilot_demand(pilot, pilot_delay),
        ModelOptions(model, None if vehicle is None else Path(vehicle)),
    )
    return FrequencyResponse(found)


def _margin(margin: Margin) -> dict[str, float]:
    return {
        "value": margin.size.value,
        "std": margin.size.std,
        "low": margin.low,
        "high": margin.high,
        "frequency": margin.frequency.value,
    }


def _place(name: str | None, names: Sequence[str], kind: str) -> int:
    """Return the index of a signal, by default the first. Raises DeclarationError."""
    name = names[0] if name is None else name
    if name not in names:
        what, remedy = f"there is no {kind} {name!r}", f"it has {', '.join(names)}"
        raise DeclarationError(what, where="response", remedy=remedy)
    return list(names).index(name)


def _window_lengths(given: float | Sequence[float]) -> tuple[float, ...]:
    lengths: Any = given if isinstance(given, list | tuple) else [given]
    for length in lengths:
        tables.refuse_wrong_type("window", length, "float")
    return tuple(map(float, lengths))
