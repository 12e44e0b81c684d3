"""The one predictive test: are data that were not fitted more probable with what is claimed?"""

from __future__ import annotations

import math

from ident.process_noise.filter_error import noise_levels, predictive_log_likelihood
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, local_names
from ident.tracing.validation.held_out import HeldOut, HeldOutData


def predictive_gains(
    less: FittedModel, more: FittedModel, held: HeldOutData, out: HeldOut
) -> tuple[float, ...]:
    """Rise of the log density of held-out data from one fitted set to another.

    Of free simulations where neither has process noise, all records together; else of predictions
    one step ahead, record by record: a free simulation cannot tell of random loads.

    Parameters
    ----------
    less, more : fitted to the same records. held : the data. out : what ``more`` predicts there.

    Returns
    -------
    The rises; minus infinity where ``more`` cannot be simulated; empty without held-out data.
    """
    if not held.records:
        return ()
    if out.frozen is None:
        return (-math.inf,)
    if held.declared.frozen is None:
        return (math.inf,)
    if not has_process_noise(more.system):
        return (held.declared.frozen.cost - out.frozen.cost,)
    gains = []
    masks = [problem.valid for problem in (out.informed or out.frozen).layout.problems]
    begin = _own_values(more, out)
    for record, mask, start in zip(held.records, masks, begin, strict=True):
        settings = more.fit.layout.settings
        total = [
            predictive_log_likelihood(
                [record],
                fitted.system,
                fitted.values.shared,
                noise_levels(fitted.fit),
                settings,
                local=[name for effect in fitted.effects for name in local_names(effect)],
                masks=[mask],
                begin=[start if fitted is more else {}],
            )
            for fitted in (less, more)
        ]
        gains.append(total[1] - total[0] if math.isfinite(total[0]) else math.inf)
    return tuple(gains)


def _own_values(fitted: FittedModel, out: HeldOut) -> list[dict[str, float]]:
    """Of each held-out record what it has of its own: an event begins where it was found there."""
    fit = out.informed or out.frozen
    assert fit is not None
    layout = fit.layout
    names = {name for effect in fitted.effects for name in local_names(effect)}
    found = []
    for r in range(len(layout.problems)):
        mine = layout.columns(r)[len(layout.shared) :]
        values = zip(layout.local, mine, strict=False)
        found.append({name: float(fit.theta[at]) for name, at in values if name in names})
    return found
