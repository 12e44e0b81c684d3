"""What the figure of a design is given."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from scenarios.maneuver_design.design import Design
from scenarios.maneuver_design.limits import offset_of
from scenarios.maneuver_design.text import pace_text, units_shown
from scenarios.plots.drawing import Named
from scenarios.plots.maneuvers import ManeuverCourse, figure_coherence, figure_maneuvers


def design_figures(design: Design) -> Iterator[Named]:
    """The figure of a design: inputs and responses of all kinds with the limits."""
    setting = design.setting
    courses = []
    for each in design.maneuvers:
        motion, flown = each.flight.motion, each.flight.planned.record
        outputs = zip(motion.system.output_names, motion.fit.lines[0].y, strict=True)
        shown = {name: row + offset_of(setting.model, name) for name, row in outputs}
        courses.append(ManeuverCourse(f"{each.kind}, {pace_text(each)}", {channel.name: channel.values for channel in flown.inputs}, shown))
    limits = {name: (setting.rest[name] - size, setting.rest[name] + size) for name, size in setting.limits.amplitude.items()}
    if design.best.responses is not None:
        kinds = [(each.kind, each.responses) for each in design.maneuvers]
        title = f"{setting.vehicle.name}: coherence expected of one flight\ndotted: 0.6, from which a response is usable"
        yield "coherence", partial(figure_coherence, kinds, title)
    title = f"{setting.vehicle.name}: maneuvers at equal amplitude and time\nthe best: {design.best.kind}; dashed: limits"
    yield "maneuvers", partial(figure_maneuvers, setting.room.time, courses, {**limits, **setting.limits.outputs}, units_shown(design), title)
