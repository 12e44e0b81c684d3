"""A maneuver made as large as its limits allow, and what the aircraft does in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.maneuver_design import Planned, simulated
from ident.tracing.candidate_model.fitted_model import FittedModel
from scenarios.maneuver_design.limits import no_faster, offset_of
from scenarios.maneuver_design.setting import Setting
from sim.errors import DeclarationError, ModelError

# behind a limit of the rate the peak hardly follows the amplitude
ATTEMPTS, USUALLY, STUBBORN = 16, 4, 3.0
INSIDE = 0.999  # of a limit: a finer simulation differs by less
TOO_WILD = 0.2  # by which a maneuver whose simulation leaves all measure is made smaller


@dataclass(frozen=True, eq=False)
class LimitedManeuver:
    """A maneuver within its limits: ``rows (inputs, N)`` from rest, the share ``scale`` of the
    amplitude, its simulation, and extremes by output.

    ``margins`` : by output, the share by which its excursion may grow until it reaches a limit;
    an output that does not move, or has no limit, has none.
    """

    rows: np.ndarray
    scale: float
    planned: Planned
    motion: FittedModel
    extremes: Mapping[str, tuple[float, float]]
    bound_by: str
    margins: Mapping[str, float] = field(default_factory=dict)


def within_limits(
    setting: Setting,
    shapes: np.ndarray,
    *,
    quick: bool = False,
    start: float = 1.0,
    bound_by: str = "",
) -> LimitedManeuver:
    """The maneuver of ``shapes (inputs, N)``, peaks of one, at the amplitude of the limits, or
    scaled down until the response stays inside.

    ``start`` : the scale to begin with, and ``bound_by`` what made it so. Raises DeclarationError
    where the limits leave nothing.
    """
    amplitude = np.array([*setting.limits.amplitude.values()])[:, None]
    rate = np.array([setting.limits.rate.get(name, np.inf) for name in setting.limits.amplitude])
    scale = min(1.0, start)
    for attempt in range(ATTEMPTS):
        rows = no_faster(scale * amplitude * shapes, rate, setting.room.interval)
        planned = setting.planned(rows, quick=quick)
        try:
            motion = simulated(planned, slopes=False)
        except ModelError:
            scale *= TOO_WILD
            continue
        extremes = _extremes(setting, motion)
        shares = used_shares(setting, extremes)
        worst, name = max(((share, name) for name, share in shares.items()), default=(0.0, ""))
        if worst <= 1.0:
            margins = {name: 1.0 / share - 1.0 for name, share in shares.items() if share > 0.0}
            return LimitedManeuver(
                rows, scale, planned, simulated(planned), extremes, bound_by, margins
            )
        scale, bound_by = scale * INSIDE / worst ** (1.0 if attempt < USUALLY else STUBBORN), name
    raise DeclarationError(
        f"no maneuver stays within {bound_by or 'the limits'}",
        where="--limits",
        remedy="widen it, shorten the flight, or check the starting values",
    )


def _extremes(setting: Setting, motion: FittedModel) -> dict[str, tuple[float, float]]:
    """Lowest and highest reading by output, load factors as totals."""
    rows = zip(motion.system.output_names, motion.fit.lines[0].y, strict=True)
    return {
        name: (
            offset_of(setting.model, name) + float(row.min()),
            offset_of(setting.model, name) + float(row.max()),
        )
        for name, row in rows
    }


def used_shares(setting: Setting, extremes: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """The excursion from rest over what its limit allows, of each output that has a limit."""
    shares = {}
    for name, (low, high) in extremes.items():
        least, most = setting.limits.outputs.get(name, (-np.inf, np.inf))
        at = setting.still[name] + offset_of(setting.model, name)
        if not least < at < most:
            raise DeclarationError(
                f"{name} is {at:g} before any maneuver",
                where="--limits",
                remedy="let the limits hold the rest",
            )
        shares[name] = max((at - low) / (at - least), (high - at) / (most - at))
    return shares
