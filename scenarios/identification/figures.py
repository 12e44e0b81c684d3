"""Figures of an identification from a measured record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
from matplotlib.figure import Figure

from scenarios.identification.assessment.prediction import RecordFit
from scenarios.identification.result import Identification
from scenarios.plots.correlation import figure_correlation
from scenarios.plots.display import MEASURED_DATA, axis_label, display_unit
from scenarios.plots.files import Named
from scenarios.plots.innovations import figure_innovations
from scenarios.plots.parameters import figure_parameter_histories
from scenarios.plots.signals import Response, figure_fit, figure_record, response_of, units_of
from scenarios.plots.style import LABEL_SIZE, LIGHT, MEASURED, TRUE, finish, make_sheet, method_style, y_label
from sim.record import Record


def identification_figures(
    found: Identification, measured: Record, data: str = MEASURED_DATA, sensor_noise: Mapping[str, float] = MappingProxyType({})
) -> Iterator[Named]:
    """The figures of an identification: stem of each file, and what draws it; ``measured`` has the channels that were recorded.

    ``data``: what the samples are called. ``sensor_noise``: of outputs whose residual is more than it; bands about residuals are drawn with it.
    """
    estimate, title = found.estimate, f"{found.record.name}: {found.vehicle.model}, {found.method}"
    yield "record", partial(figure_record, measured, title, data)
    response = response_of(estimate)
    noise = dict(zip(estimate.output_names, estimate.noise_std.tolist(), strict=True))
    sensors = {**noise, **sensor_noise}
    yield "fit", partial(figure_fit, found.record, [response], None, title, sensors, data)
    yield from other_records(found, sensors, data)
    if found.band is not None and found.fits[0].figures is not None:
        yield "spectra", partial(figure_spectra, found.fits[0], noise, found.band, title, data)
    if estimate.history is not None:
        followed = [(name, unit) for name, unit in zip(estimate.names, estimate.units, strict=True) if name in estimate.history.names]
        names, kinds = zip(*followed, strict=True)  # a delay that a bank found has no history
        yield "parameters", partial(figure_parameter_histories, estimate.history, names, kinds, title=title)
        units = units_of(found.record, estimate.output_names)
        yield "innovations", partial(figure_innovations, estimate.history, estimate.output_names, units, title)
    if len(estimate.names) > 1:
        yield "correlation", partial(figure_correlation, estimate.names, estimate.correlation, title)


def other_records(found: Identification, noise: Mapping[str, float], data: str = MEASURED_DATA) -> Iterator[Named]:
    """The free simulation of every record but the first: ``fit_2``, ..., and ``held_out``, ``held_out_2``, ... of those that were not fitted."""
    count = {True: 0, False: 0}
    for each in found.fits:
        count[each.held_out] += 1
        number = count[each.held_out]
        if each.figures is None or (number == 1 and not each.held_out):
            continue
        word = "held out, only initial states and biases are its own" if each.held_out else "fitted"
        name = f"{'held_out' if each.held_out else 'fit'}{f'_{number}' if number > 1 else ''}"
        response = Response("free simulation", dict(zip(each.outputs, each.simulated, strict=True)))
        title = f"{each.record.name}: {found.vehicle.model}, {found.method}\n{word}"
        yield name, partial(figure_fit, each.record, [response], None, title, noise, data)


def figure_spectra(each: RecordFit, noise: Mapping[str, float], band: tuple[float, float], title: str = "", data: str = MEASURED_DATA) -> Figure:
    """Amplitudes of the recorded and the simulated outputs and of their difference at the record's harmonics; what was fitted is shaded.

    Of a transform over the root of the number of samples, so that white noise has its own standard deviation at every frequency. Angles in
    degrees.
    """
    record = each.record
    shown = [channel for channel in record.outputs if channel.name in each.outputs and np.any(channel.valid)]
    sheet = make_sheet([1.3] * len(shown), row_gap=0.18)
    count = len(record)
    frequency = np.arange(1, (count + 1) // 2) * (count - 1) / count / (record.time[-1] - record.time[0])
    for channel, panel in zip(shown, sheet.panels, strict=True):
        unit = display_unit(channel.unit)
        bridged = np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])  # gaps as the fit bridges them
        rows = bridged, each.simulated[each.outputs.index(channel.name)]
        measured, simulated = (unit.factor * np.fft.rfft(row)[1 : len(frequency) + 1] / np.sqrt(count) for row in rows)
        panel.axvspan(*band, color=LIGHT, alpha=0.5, linewidth=0, label="fitted")
        panel.plot(frequency, np.abs(measured), label=data, **{**MEASURED, "markersize": 5.0})
        panel.plot(frequency, np.abs(simulated), label="free simulation", **method_style(0, alone=True))
        panel.plot(frequency, np.abs(measured - simulated), label="their difference", **method_style(1, alone=True))
        if channel.name in noise:
            panel.axhline(unit.factor * noise[channel.name], label="noise level of the fit", **TRUE)
        panel.set_xscale("log")
        panel.set_yscale("log")
        y_label(panel, axis_label(channel.name, unit))
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.16)
