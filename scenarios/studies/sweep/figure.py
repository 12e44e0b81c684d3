"""What the figure of a sweep is given."""

from __future__ import annotations

import math

from matplotlib.figure import Figure

from scenarios.plots.studies.flexibility import CriterionCourse, DerivativeCourse, Published, figure_flexibility
from scenarios.studies.sweep.criteria import criteria_of
from scenarios.studies.sweep.sweep import Sweep

# Axis, legend, and what is drawn to scale.
LABELS = {
    "likelihood": ("BIC gain of an elastic mode (–)", "from here on a mode is likelier (BIC)", (-100.0, 300.0)),
    "whiteness": (r"$\log_{10}$ p(residual white)", "the residual is not white", (-20.0, 0.0)),
    "misfit": (r"$\log_{10}$ (misfit / noise)", "no rigid model fits to the noise", (-math.inf, math.inf)),
}


def draw_sweep(sweep: Sweep, title: str) -> Figure:
    """Equivalent derivatives over the degree of flexibility by the main method and by those with modes, with the criteria's courses below."""
    points = sweep.points
    degrees = [point.figures.degree for point in points]
    courses = []
    for name, rigid in sweep.rigid.items():
        estimates = {}
        for number, method in enumerate(points[0].methods):
            if name in method.names and (number == 0 or method.estimation.modes != points[0].methods[0].estimation.modes):
                at = method.names.index(name)
                found = [(float(point.methods[number].values[at]), float(point.methods[number].std[at])) for point in points]
                estimates[method.estimation.label] = found
        printed = [
            Published(sweep.point(mark.frequency_factor).figures.degree, start.value, start.std)
            for mark, values in sweep.marks
            if (start := values.get(name)) is not None
        ]
        condensed, best = [point.figures.condensed[name] for point in points], [point.figures.fitted[name] for point in points]
        courses.append(DerivativeCourse(name, sweep.units[name], rigid, condensed, best, estimates, printed))
    criteria = [CriterionCourse(*LABELS[each.name][:2], each.limit, each.values, each.degree, LABELS[each.name][2]) for each in criteria_of(points)]
    marks = {mark.label: sweep.point(mark.frequency_factor).figures.degree for mark, _ in sweep.marks}
    return figure_flexibility(degrees, courses, criteria, marks, title)
