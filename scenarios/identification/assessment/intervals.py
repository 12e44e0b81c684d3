"""Profile-likelihood intervals of an identification."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from ident.estimate import Estimate, Outcome
from ident.statistics.intervals import ProfileInterval
from ident.whole_record.layout import FitSettings, lay_out
from scenarios.files.declarations import closest
from sim.declaration.model import System
from sim.errors import DeclarationError
from sim.record import Record

PROFILED = ("output-error", "filter-error", "frequency-domain")  # methods with a likelihood of whole records
SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


def refuse_profile(method: str) -> None:
    """Raise DeclarationError where a method has no likelihood to be followed."""
    if method not in PROFILED:
        what = f"{method} has no likelihood of whole records that a profile could follow"
        raise DeclarationError(what, where="--profile", remedy=f"use --method {' or '.join(PROFILED)}")


def chosen_names(wanted: Sequence[str], estimate: Estimate, held: Collection[str] = ()) -> tuple[str, ...]:
    """The parameters asked for, all where none is named. Raises DeclarationError for one that is not estimated, as those that are ``held``."""
    known = [name for name in estimate.names if not name.startswith("bias_")]
    for name in wanted:
        if name not in known and name in held:
            what = f"{name} is fixed, tied or at its bound: no interval is its own"
            raise DeclarationError(what, where="--profile", remedy=f"use one of {', '.join(known)}")
        if name not in known:
            raise DeclarationError(f"no parameter {name!r} is estimated", where="--profile", remedy=closest(name, known))
    return tuple(wanted) or tuple(known)


def profiled(
    estimate: Estimate,
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    wanted: Sequence[str],
    *,
    calm: System | None = None,
    local: Collection[str] = (),
    delays: Mapping[str, str] | None = None,
    band: tuple[float, float] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Intervals of the parameters ``wanted`` (all where none is named) of a settled estimate; none where it did not settle.

    ``system`` is the one that was estimated; ``calm`` (filter error) the same without forcing; ``delays`` and ``band`` (frequency domain).
    The fit is made once more from what it found, which takes a step or two.
    """
    names = chosen_names(wanted, estimate, [item.name for item in system.parameters if not item.free])
    if estimate.outcome not in SETTLED:
        return ()
    known = {name: value for name, value in estimate.as_dict().items() if name in system.parameters}
    names = tuple(name for name in names if name in known)
    n = [estimate.names.index(name) for name in estimate.names if name in known]
    covariance = estimate.covariance[:, n][n]
    if estimate.method == "frequency-domain":
        from ident.frequency_domain import profiled as frequency
        from ident.frequency_domain.output_error import FrequencySettings, frequency_fit

        # Priors stay where the file's starts are: only a fit without them may begin elsewhere.
        begun = system if settings.use_priors else replace(system, parameters=system.parameters.with_values(known))
        found, _ = frequency_fit(records, begun, FrequencySettings(band, settings.use_priors), delays=delays)
        return () if found is None else frequency.profile_intervals(found, names, covariance)
    from ident.whole_record.gauss_newton import profile_intervals
    from ident.whole_record.output_error import in_pieces

    pieces = [piece for each in in_pieces(records, calm or system, settings, local) for piece in each]
    begun = system if settings.use_priors else replace(system, parameters=system.parameters.with_values(known))
    layout = lay_out(pieces, begun, settings, local=local)
    if estimate.method == "filter-error":
        from ident.process_noise.best_start import fit_from_best_start as fit_with_filter
        from ident.process_noise.innovations_model import noise_started_at

        fit = fit_with_filter(layout, calm)
        return () if fit is None else profile_intervals(fit, names, covariance, noise_started_at)
    from ident.whole_record.output_error import fit_from_best_start

    fit = fit_from_best_start(layout)
    return () if fit is None else profile_intervals(fit, names, covariance)
