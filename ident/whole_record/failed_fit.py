"""Whether a fit by free simulation has failed: what it says of the derivatives is then no estimate, and nothing can be built on it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ident.statistics.contradictions import THREEFOLD
from ident.whole_record.best_start import FOLLOWED, RUNAWAY
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.output_error import fit_covariance
from ident.whole_record.unstable_motion import GROWN, fastest

UNDETERMINED = "the records determine none of the derivatives"


def failed_simulation(channels: Mapping[str, str], measured: Sequence[np.ndarray], residuals: Sequence[np.ndarray]) -> str:
    """Why simulated outputs are no fit of what was measured; empty where they are one.

    A simulation has run away where it leaves a channel by ten times the channel's own motion. A fit is worse than none where a level of
    each channel by itself would be likelier: an aircraft that does not move is among the models, so that no minimum lies above it.

    Parameters
    ----------
    channels : units by name. measured, residuals : of each channel the valid samples of all records, ``(K,)``; measured ones about
        each record's mean.
    """
    apart = []
    for values, left in zip(measured, residuals, strict=True):
        motion, error = float(np.sqrt(np.mean(values**2))), float(np.sqrt(np.mean(left**2)))
        apart.append((motion, error, len(values)))
    known = [(name, unit, *each) for (name, unit), each in zip(channels.items(), apart, strict=True) if each[0] > 0.0]
    worst = max(known, key=lambda each: each[3] / each[2], default=None)
    if worst is None:
        return ""
    name, unit, motion, error, _ = worst
    said = f"{name} error {error:.2g} {unit}, of a motion of {motion:.2g} {unit}"
    if not error <= RUNAWAY * motion:
        return f"the free simulation runs away from the record ({said})"
    likelier = sum(count * math.log(max(error, 1e-300) / motion) for _, _, motion, error, count in known)
    return f"the fit explains nothing: constant levels are likelier ({said})" if likelier > 0.0 else ""


def none_determined(sigmas: Iterable[tuple[float, float]]) -> bool:
    """Whether no derivative is known within three times its declared size, from pairs of a standard deviation and the declared value.

    A vehicle file may be 30 % wrong: a sigma of ten times that says nothing that the file does not say. Values declared as zero do not
    count.
    """
    known = [(std, abs(declared)) for std, declared in sigmas if declared != 0.0]
    return bool(known) and all(not std <= THREEFOLD * size for std, size in known)


def failed_fit(fit: Fit, declared: Mapping[str, float]) -> tuple[str, str]:
    """Why an output-error fit has failed and what to do; both empty where it has not. ``declared`` values by parameter."""
    layout = fit.layout
    names, problems = layout.system.output_names, layout.problems
    units = {output.name: output.unit for output in layout.system.outputs}
    used = [i for i in range(len(names)) if any(np.any(problem.valid[i]) for problem in problems)]
    known = [[(problem.z[i, row] - np.mean(problem.z[i, row])) for problem in problems if np.any(row := problem.valid[i])] for i in used]
    left = [[fit.residuals[r][i, problem.valid[i]] for r, problem in enumerate(problems)] for i in used]
    channels = {names[i]: units[names[i]] for i in used}
    why = failed_simulation(channels, [np.concatenate(each) for each in known], [np.concatenate(each) for each in left])
    if not why:
        with np.errstate(all="ignore"):
            covariance, _ = fit_covariance(fit)
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        pairs = [(float(sigmas[i]), declared[name]) for i, name in enumerate(layout.shared) if name in declared]
        why = UNDETERMINED if none_determined(pairs) else ""
    return (why, _remedy(fit)) if why else ("", "")


def _remedy(fit: Fit) -> str:
    """What to do about a failed fit; of a motion that grows by itself, how long a record may be."""
    layout = fit.layout
    rate = max(fastest(layout), fastest(layout, fit.theta))
    longest = max(float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems)
    if GROWN < rate * longest < math.inf:
        cut = f"cut the records to single maneuvers of at most {FOLLOWED / rate:.2g} s (--from, --to)"
        return (
            f"the motion is unstable and grows e-fold every {1.0 / rate:.2g} s, as of an aircraft that a controller holds: estimate with "
            f"flightid identify --method filter-error or equation-error, which simulate nothing freely, or {cut}"
        )
    return (
        "check units, signs and the declared values; use records or maneuvers that are shorter or smaller; an unstable aircraft that a "
        "controller holds needs flightid identify --method filter-error or equation-error"
    )
