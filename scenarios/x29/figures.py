"""Which figures a closed-loop study gets: as the paper's 3 to 10."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.estimate import FilterHistory
from scenarios.plots.correlation import figure_correlation
from scenarios.plots.display import SIMULATED_DATA
from scenarios.plots.files import Named
from scenarios.plots.innovations import figure_innovations
from scenarios.plots.low_order import (
    Bar,
    LikelihoodCurve,
    figure_delays,
    figure_linear,
    figure_open_margins,
    figure_peaks,
    figure_side_by_side,
    figure_states,
)
from scenarios.plots.parameters import figure_parameter_histories
from scenarios.plots.signals import Response, figure_fit, figure_record, units_of
from scenarios.x29.loop.linear_check import OUTPUTS
from scenarios.x29.loop.open_margins import OpenMargins
from scenarios.x29.loop.open_values import OPEN
from scenarios.x29.published import printed_column
from scenarios.x29.study import LoopStudy, Result
from sim.declaration.effect import Parameter

SHOWN = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")


def loop_figures(study: LoopStudy) -> Iterator[Named]:
    """A study's figures: the stem of each file, and what draws it."""
    result, title = study.result, study.scenario.title
    estimate, record = result.estimate, result.setting.record
    history = estimate.history
    assert history is not None
    yield "record", partial(figure_record, result.flown.record, f"{title}\nrecord", SIMULATED_DATA)
    noise = dict(zip(("alpha", "q", "nz"), (float(v) for v in estimate.noise_std), strict=True)) if study.scenario.flight.noise else None
    simulated = [_response("low-order equivalent, free simulation", study.simulated)]
    yield "fit", partial(figure_fit, record, simulated, None, f"{title}\nfree simulation", noise, SIMULATED_DATA)
    if study.other is not None and study.other_simulated is not None and study.scenario.against is not None:
        label = study.scenario.against.label
        shown = [_response("low-order equivalent, free simulation", study.other_simulated)]
        yield "fit_other", partial(figure_fit, study.other.setting.record, shown, None, f"{title}\ncompared with: {label}", None, SIMULATED_DATA)
        yield "compared", partial(figure_side_by_side, _bars(study.other), _bars(result), label, "this study", title, _printed(study))
    yield "innovations", partial(figure_innovations, history, estimate.output_names, units_of(record, estimate.output_names), title)
    system = result.setting.system
    items = [system.initial[n] if n in system.state_names else system.parameters[n] for n in history.names]
    moving, constant = items[: len(system.state_names)], items[len(system.state_names) :]
    names = [item.name for item in moving]
    yield "states", partial(figure_states, history, names, [item.unit for item in moving], f"{title}\nstates of the filter")
    yield "parameters", partial(_parameter_histories, history, constant, f"{title}\nparameters as states")
    yield "correlation", partial(figure_correlation, estimate.names, estimate.correlation, title)
    bank = result.bank
    curve = LikelihoodCurve(bank.delays, bank.log_likelihood, bank.most_likely, bank.weighted_mean, bank.refined, bank.refined_std)
    yield "delays", partial(figure_delays, curve, title)
    if (check := study.linear) is not None:
        units, words = ("rad", "rad/s", "g"), f"{title}\nflown and linear"
        yield "linear", partial(figure_linear, check.time, check.flown, check.linear, OUTPUTS, units, check.sticks, check.curves, words)
    if study.open_margins is not None:
        yield "margins", partial(_margins, study, study.open_margins)
    if study.variants and study.scenario.peak is not None:
        rows = [("as declared", study.misfit.peak_percent), *((v.label, v.misfit.peak_percent) for v in study.variants)]
        yield "variants", partial(figure_peaks, rows, "final peak of q, free simulation against the record (%)", title)
    elif study.variants:
        stretch = study.scenario.stretch is not None
        words = "rms of q in the stretch over σ (–)" if stretch else "lag-1 correlation of pitch-rate innovations (–)"
        found = [("as declared", study.misfit), *((v.label, v.misfit) for v in study.variants)]
        rows = [(label, m.stretch if stretch else m.lag_one) for label, m in found]
        yield "variants", partial(figure_peaks, rows, words, title)


def _parameter_histories(history: FilterHistory, constant: Sequence[Parameter], title: str) -> Figure:
    """The histories with fewer numbers at their axes: a flight is long."""
    prior = {item.name: (item.value, item.prior_std) for item in constant}
    names, units = [item.name for item in constant], [item.unit for item in constant]
    figure = figure_parameter_histories(history, names, units, prior=prior, title=title)
    for panel in figure.axes:
        panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    return figure


def _printed(study: LoopStudy) -> list[dict[str, float]]:
    """Printed values of the other scenario's column and of this one's, as far as there are any."""
    scenarios = (study.other.scenario if study.other is not None else None, study.scenario)
    columns = [scenario.published[0] if scenario is not None and scenario.published else "" for scenario in scenarios]
    return [{name: cell.value for name, cell in printed_column(each).items()} if each else {} for each in columns]


def _margins(study: LoopStudy, found: OpenMargins) -> Figure:
    """Every point that has the paper's equivalents, the declared airframes, and what each open value does."""
    clouds = [(each.name, each.simulation[each.plausible], each.flight[each.plausible]) for each in found.designs]
    (own, mine), (against, theirs), *beside = study.margins.items()
    declared = [(f"{name} and {against}, declared", theirs.phase, each.phase) for name, each in ((own, mine), *beside)]
    effects = [(item.label, found.effects[item.name]) for item in OPEN if item.name in found.effects]
    title = f"{study.scenario.title}\nphase margins that the paper's numbers leave open"
    return figure_open_margins(clouds, declared, effects, title)


def _response(label: str, outputs: np.ndarray) -> Response:
    return Response(label, dict(zip(("alpha", "q", "nz"), outputs, strict=True)))


def _bars(result: Result) -> dict[str, Bar]:
    estimate = result.estimate
    out = {n: Bar(estimate.value(n), estimate.sigma(n), estimate.units[estimate.names.index(n)]) for n in SHOWN if n in estimate.names}
    for name in ("natural_frequency", "damping_ratio"):
        quality = result.quality(name)
        if quality is not None:
            out[name] = Bar(quality.value, quality.std, quality.unit)
    return out
