"""Estimators in Python, each a function of a model and a record.

Nothing is prepared, checked or written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

from scenarios.api.record import Record, read_record
from scenarios.api.vehicle import Vehicle, source_of
from sim.declaration.model import Model
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from ident.estimate import Estimate
    from ident.filters.smoother import SmoothedHistory
    from sim import record as sim_record

__all__ = ["ekf", "equation_error", "filter_error", "output_error", "smoother", "ukf"]

ModelOrName = Model | str
VehicleSource = str | PathLike[str] | Mapping[str, Any] | Vehicle | None


def output_error(
    model: ModelOrName, records: Record | Any | Sequence[Any], vehicle: VehicleSource = None
) -> Estimate:
    """Maximum likelihood by simulation of whole records: process noise is not modelled.

    Parameters
    ----------
    model : a name of ``models()``, with a vehicle; or the result of ``own_model``.
    records : one record or several: ``Record``, or what ``read_record`` takes. Channels that the
        model does not know are ignored. Each output gets a bias, each record an initial state.
    vehicle : constants and starting values for a model that is named.

    Returns
    -------
    Estimate
        ``names``, ``values`` and ``std`` ``(n,)``, ``covariance`` ``(n, n)``, SI and radians;
        ``fitted``, one array ``(m, N)`` a record; ``outcome``.

    Raises
    ------
    InputError
        There is no such model, the vehicle is not one for it, or no output is measured.

    References
    ----------
    .. [1] V. Klein and E. A. Morelli, Aircraft System Identification, AIAA, 2006, chapter 6.

    Examples
    --------
    >>> import flightid as fid
    >>> record = fid.simulate("rigid", seed=3).record
    >>> found = fid.estimators.output_error("rigid", record, "bomber_rigid")
    >>> found.outcome.code, round(found.value("Cm_alpha"), 2)
    ('converged', -1.66)
    """
    return _estimate("output-error", model, records, vehicle)


def filter_error(
    model: ModelOrName, records: Record | Any | Sequence[Any], vehicle: VehicleSource = None
) -> Estimate:
    """Maximum likelihood by the innovations of a Kalman filter, with process noise of unknown size.

    An aircraft flies through Dryden turbulence, other models have white noise on their states.

    Parameters, returns and errors as in ``output_error``; ``fitted`` is predicted one sample ahead.

    References
    ----------
    .. [1] R. V. Jategaonkar, Flight Vehicle System Identification, 2nd edition, AIAA, 2015,
       chapter 5.
    """
    return _estimate("filter-error", model, records, vehicle)


def equation_error(
    model: ModelOrName, records: Record | Any | Sequence[Any], vehicle: VehicleSource = None
) -> Estimate:
    """Least squares on the equations of motion, with differentiated and smoothed measurements.

    Parameters, returns and errors as in ``output_error``. Each state has to be measured, or to be
    the rate of a measured one.

    References
    ----------
    .. [1] V. Klein and E. A. Morelli, Aircraft System Identification, AIAA, 2006, chapter 5.

    Examples
    --------
    >>> import flightid as fid
    >>> record = fid.simulate("rigid", seed=3).record
    >>> found = fid.estimators.equation_error("rigid", record, "bomber_rigid")
    >>> abs(found.value("Cm_alpha") + 1.66) < 4 * found.sigma("Cm_alpha")
    True
    """
    return _estimate("equation-error", model, records, vehicle)


def ekf(model: ModelOrName, record: Record | Any, vehicle: VehicleSource = None) -> Estimate:
    """Extended Kalman filter, iterated about its own smoothed result.

    Parameters
    ----------
    model, vehicle : as in ``output_error``.
    record : one record; an output-error fit of it gives noise levels and starting values.

    Returns
    -------
    Estimate
        As in ``output_error``, with ``history``: mean and standard deviation of states and
        parameters ``(n, N)``, innovations ``(m, N)``.

    References
    ----------
    .. [1] A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970,
       chapter 8.
    """
    return _estimate("ekf", model, record, vehicle)


def ukf(model: ModelOrName, record: Record | Any, vehicle: VehicleSource = None) -> Estimate:
    """Unscented Kalman filter, iterated about its own smoothed result; otherwise as ``ekf``.

    References
    ----------
    .. [1] S. J. Julier and J. K. Uhlmann, "Unscented Filtering and Nonlinear Estimation",
       Proceedings of the IEEE 92(3), 2004.
    """
    return _estimate("ukf", model, record, vehicle)


def smoother(estimate: Estimate) -> SmoothedHistory:
    """Return states and parameters at each sample given the whole record.

    Parameters
    ----------
    estimate : result of ``ekf`` or ``ukf``.

    Returns
    -------
    SmoothedHistory
        ``time`` ``(N,)`` s; ``mean`` and ``std`` ``(n, N)`` in the order of ``names``.

    Raises
    ------
    InputError
        The estimate is not that of a filter.

    References
    ----------
    .. [1] G. J. Bierman, "Fixed Interval Smoothing with Discrete Measurements", International
       Journal of Control 18(1), 1973.
    """
    from ident.filters.smoother import smooth

    if estimate.history is None:
        raise DeclarationError(
            f"an estimate by {estimate.method} has no history to smooth",
            where="smoother",
            remedy="give what ekf or ukf returned",
        )
    return smooth(estimate.history)


def _estimate(method: str, model: Any, records: Any, vehicle: VehicleSource) -> Estimate:
    from ident.whole_record.layout import FitSettings
    from scenarios.identification.assessment import DEFAULT_OPTIONS
    from scenarios.identification.methods import FILTERS, estimated_by
    from scenarios.preparation.declared_model import outputs_with_bias, sub_step
    from scenarios.preparation.plausibility import refuse_too_few
    from scenarios.studies.estimating import FIT_STEP

    if not isinstance(model, Model | str | PathLike):
        what = f"a {type(model).__name__} is no model"
        raise DeclarationError(what, where=method, remedy="give the model first, then the record")
    declared, priors = _declared(model if isinstance(model, Model) else fspath(model), vehicle)
    sources = records if isinstance(records, list | tuple) else [records]
    given = [_of_model(read_record(source), declared) for source in sources]
    if method in FILTERS and len(given) != 1:
        raise DeclarationError(
            f"a filter runs along one record, and there are {len(given)}",
            where=method,
            remedy="give one record",
        )
    outputs = [
        signal.name
        for signal in declared.equations.outputs
        if any(signal.name in record.output_names for record in given)
    ]
    biased = declared.with_biases(outputs_with_bias(declared, outputs))
    refuse_too_few(given, declared)
    settings = FitSettings(sub_step(biased, given, FIT_STEP), use_priors=priors)
    return estimated_by(given, biased, outputs, method, settings, DEFAULT_OPTIONS)[1]


def _declared(model: ModelOrName, vehicle: VehicleSource) -> tuple[Model, bool]:
    """Return the model with its numbers, and whether a fit uses priors, as for elastic modes."""
    from scenarios.files.vehicles import read_vehicle
    from scenarios.preparation.declared_model import model_of_file

    if isinstance(model, Model):
        return model, False
    file = read_vehicle(source_of(vehicle, model), model)
    return model_of_file(file), bool(file.modes)


def _of_model(record: Record, model: Model) -> sim_record.Record:
    """Return the channels of a record that a model knows."""
    from sim.record import Channel, Hold
    from sim.record import Record as SimRecord

    def channels(signals: Sequence[Any]) -> tuple[Channel, ...]:
        names = [signal.name for signal in signals if signal.name in record]
        return tuple(Channel.of(name, record.units[name], record[name]) for name in names)

    inputs, outputs = channels(model.equations.inputs), channels(model.equations.outputs)
    missing = [
        signal.name
        for signal in model.equations.inputs
        if signal.name not in {channel.name for channel in inputs}
    ]
    if missing or not outputs:
        what = f"no {', '.join(missing)}" if missing else "none of the model's outputs"
        raise DeclarationError(
            f"the record has {what}",
            where=record.name,
            remedy=f"it has {', '.join(record.names)}; name columns with read_record(channels=)",
        )
    return SimRecord(record.time, inputs, outputs, Hold(record.hold), record.name)


def __dir__() -> list[str]:
    return __all__
