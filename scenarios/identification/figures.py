"""Figures of an identification from a measured record."""

from __future__ import annotations

from pathlib import Path

from scenarios.identification.result import Identification
from scenarios.plots.correlation import figure_correlation
from scenarios.plots.files import save_figure
from scenarios.plots.innovations import figure_innovations
from scenarios.plots.parameters import figure_parameter_histories
from scenarios.plots.signals import figure_fit, figure_record, response_of, units_of
from sim.record import Record


def draw_identification(found: Identification, measured: Record, folder: Path) -> None:
    """Draw the figures of a measured record's identification into ``folder``; ``measured`` is the record with the channels that were recorded."""
    estimate, title = found.estimate, f"{found.record.name}: {found.vehicle.model}, {found.method}"
    save_figure(figure_record(measured, title), folder, "record")
    response = response_of(estimate)
    noise = dict(zip(estimate.output_names, estimate.noise_std.tolist(), strict=True))
    save_figure(figure_fit(found.record, [response], None, title, noise), folder, "fit")
    if estimate.history is not None:
        save_figure(figure_parameter_histories(estimate.history, estimate.names, estimate.units, title=title), folder, "parameters")
        units = units_of(found.record, estimate.output_names)
        save_figure(figure_innovations(estimate.history, estimate.output_names, units, title), folder, "innovations")
    if len(estimate.names) > 1:
        save_figure(figure_correlation(estimate.names, estimate.correlation, title), folder, "correlation")
