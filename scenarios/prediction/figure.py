"""The figure of a prediction."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.plots.files import Named
from scenarios.plots.signals import Response, figure_fit
from scenarios.prediction.predict import Prediction


def prediction_figures(found: Prediction) -> Iterator[Named]:
    """The figure of a prediction: recorded and predicted, of a diagnosis with effects also as declared. Nothing where no simulation is finite."""
    if found.after.figures is None:
        return
    shown = [Response("predicted", dict(zip(found.channels, found.after.rows, strict=True)))]
    if found.before is not None and found.kept.after.effects:
        shown.insert(0, Response("as declared", dict(zip(found.channels, found.before.rows, strict=True))))
    title = f"{found.record.name}: {found.kept.model}, {found.kept.made_by}\nnot fitted, only initial states and biases are its own"
    data = SIMULATED_DATA if found.simulated else MEASURED_DATA
    yield "prediction", partial(figure_fit, found.record, shown, None, title, {}, data)
