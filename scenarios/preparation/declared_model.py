"""The declared model of a vehicle file, and comparison of two interpretations of the same records
by fits of this model.

An interpretation is an assumption on the records, such as inputs held or linear between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import Outcome
from ident.statistics.noise_levels import input_edges, isolated_wrong_samples
from ident.statistics.residual_spectrum import effective_share
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import FitLayout, FitSettings, lay_out
from ident.whole_record.output_error import fits_at_lowest_minimum
from scenarios.files.sources import LARGEST_NUMBER
from scenarios.files.user_models import constrained, inputs_at_rest, is_own
from scenarios.files.vehicles import VehicleFile, with_priors
from scenarios.preparation.measured_inputs import about_trim, lacks_trim, of_totals
from scenarios.preparation.plan import MEASURED_MOTION
from sim.declaration.compile import compile_model
from sim.declaration.model import Biased, Model, System
from sim.maths import complex_step_jacobian
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import MODE_CONSTANTS, model_from_constants

# ---- From a user's vehicle file to the model it declares

# Outputs that show the lift. A short period needs one of them beside q.
LIFT_OUTPUTS = frozenset(("alpha", "nz", "az"))
NO_LIFT = (
    "q alone does not tell the lift from the moment, whatever is flown: alpha, nz or az is needed; "
    "without a vane map az from the accelerometer of the IMU"
)
# Constants of an elastic mode: key in a vehicle file -> name in the equations.
MODE_NAMES = {"frequency": "omega", "damping": "zeta", "generalized_mass": "generalized_mass"}
INTEGRATOR_ROOT = 1e-9  # rad/s; a smaller root is an integrator
# Runge-Kutta step over the time constant of the fastest root: the error is about 1e-6.
RESOLVED_STEP_SHARE = 0.15
MOST_SUB_STEPS = 200.0  # sub-steps between samples; faster motion is not resolved
# If a sample interval is longer than this many usual sub-steps, the motion is taken to be slow.
SLOW_MOTION_SUB_STEPS = 10.0


def model_of_file(vehicle: VehicleFile) -> Model:
    """Return the declared model of a vehicle file.

    Each free parameter has a prior standard deviation of half its starting value, since files may
    be 30 % wrong. Filters need it. Fits of whole records use it only with elastic modes: the data
    cannot determine the scale of a modal coordinate.
    """
    if vehicle.own is not None:
        return constrained(with_priors(vehicle.own, list(vehicle.derivatives)), vehicle.constraints)
    values = {**vehicle.derivatives}
    constants = {**vehicle.constants}
    for number, mode in vehicle.modes:
        for name, value in mode.items():
            if name in MODE_NAMES:
                constants[f"{MODE_NAMES[name]}{number}"] = value
            else:
                values[name] = value
    kind = "rigid" if vehicle.model == "flexible" else vehicle.model
    start = (
        {"airspeed": constants["reference_airspeed"]} if "reference_airspeed" in constants else {}
    )
    model = model_from_constants(kind, constants, values, modes=len(vehicle.modes), initial=start)
    free = [
        item.name
        for item in model.parameters
        if item.name in values and not _fixed_modal(item.name, len(vehicle.modes))
    ]
    return constrained(with_priors(model, free), vehicle.constraints)


def outputs_with_bias(model: Model, outputs: Sequence[str]) -> list[str]:
    """Return the outputs that have a bias: those that the equations name, else all but an altitude.

    The bias of the altitude of a falling body is equivalent to another ballistic coefficient.
    """
    if isinstance(model.equations, Biased):
        return [name for name in outputs if name in model.equations.biased_outputs]
    return [name for name in outputs if name != "altitude"]


def sub_step(model: Model, records: Sequence[Record], usual: float) -> float:
    """Return the longest integration sub-step, s: ``usual``, s, for a built-in model.

    A user's model may be much slower or faster than an aircraft, see ``sub_step_of_user_model``.
    """
    if not is_own(model) or not records:
        return usual
    return sub_step_of_user_model(model, float(np.median(np.diff(records[0].time))), usual)


def sub_step_of_user_model(model: Model, interval: float, usual: float) -> float:
    """Return the sub-step of a user model, s, for a sample interval ``interval``, s.

    It is ``RESOLVED_STEP_SHARE`` of the time constant of the fastest root, but at most ``usual``,
    s; at most the sample interval if that exceeds 10 usual sub-steps.
    """
    sizes = root_sizes(compile_model(model), inputs_at_rest(model))
    resolved = RESOLVED_STEP_SHARE / float(np.max(sizes)) if len(sizes) else math.inf
    longest = usual if interval <= SLOW_MOTION_SUB_STEPS * usual else interval
    return min(max(resolved, interval / MOST_SUB_STEPS), longest)


def root_sizes(system: System, u: list[float]) -> np.ndarray:
    """Return the magnitudes of the roots at the initial state, rad/s, without integrators.

    ``u``: the inputs. The result is empty if the Jacobian is not finite.
    """
    p = system.parameters.values().tolist()
    slopes = complex_step_jacobian(
        lambda x: system.f(0.0, x, u, p), system.initial.values().tolist()
    )
    sizes = np.abs(np.linalg.eigvals(slopes)) if np.all(np.isfinite(slopes)) else np.zeros(0)
    return np.asarray(sizes[sizes > INTEGRATOR_ROOT])


def _fixed_modal(name: str, modes: int) -> bool:
    """Return whether a parameter is a constant of a mode or couples two modes; these are fixed."""
    return any(
        name in (f"Ceta{i}_eta{j}", f"Ceta{i}_etadot{j}")
        for i in range(1, modes + 1)
        for j in range(1, modes + 1)
        if i != j
    ) or any(name == f"{local}{i}" for local in MODE_CONSTANTS for i in range(1, modes + 1))


# ---- Two interpretations of the same records

# The second interpretation is accepted above this. Twice the log likelihood ratio, for effective
# samples.
DECISIVE_LOG_LIKELIHOOD_RATIO = 10.0
# A record contradicts the others beyond this; unit as above.
CONTRADICTING_LOG_LIKELIHOOD_RATIO = 2.0
# A comparison needs the log likelihood only to within half a unit.
COMPARISON_SETTINGS = FitSettings(max_step=0.02, iterations=60, enough=0.5, coloured=False)
MOST_COMPARED_SAMPLES = 3000  # a comparison uses no further record beyond these samples
# An input is taken as a computer's command only if more than this share of its samples equals the
# one before,
UNMOVED_STEP_SHARE = 0.7
# and only if fewer than this share of its steps follow a step in the same direction; more indicates
# a hand or an actuator.
CONTINUED_STEP_SHARE = 0.5
Interpretation = tuple[Model, list[Record]]


@dataclass(frozen=True)
class Compared:
    """Comparison of two interpretations of the same records.

    Attributes
    ----------
    gain : twice the log likelihood ratio of the second interpretation to the first, for the
        effective number of samples; zero if undecided.
    why_open : reason why the comparison is undecided; else empty.
    """

    gain: float
    why_open: str = ""


def compared_interpretations(
    first: Interpretation,
    second: Interpretation,
    outputs: Sequence[str],
    least: float = 0.0,
    local: Collection[str] = (),
) -> Compared:
    """Compare two interpretations of the same records by fits of the declared model.

    Isolated wrong samples are left out. Controls count from their trim (``from_trim``). The
    comparison is undecided (gain zero) in these cases:

    - a fit is impossible, does not converge, has an implausible bias (``implausible_bias``), or has
      as many unknowns as samples;
    - a single record contradicts the sum of all. A missing effect may favour the wrong one in a
      maneuver, but the correct one fits best in all;
    - the second interpretation reduces no channel's residual by the share ``least``.

    Parameters
    ----------
    first, second : model and records of each interpretation.
    outputs : the outputs that are fitted.
    least : least share by which a residual has to fall.
    local : parameters with a separate value for each record.
    """
    if any(
        np.max(np.abs(channel.values)) > LARGEST_NUMBER
        for record in first[1]
        for channel in record.channels
    ):
        return Compared(0.0, "a number is beyond all measure")  # reported by the fit
    first, second = (
        (model, [from_trim(record, model) for record in records])
        for model, records in (first, second)
    )
    old, new = fits_at_lowest_minimum(
        _layout(first, outputs, local), _layout(second, outputs, local)
    )
    wrong = _wrong_samples(old, new)
    if any(np.any(mask) for mask in wrong):
        first, second = (
            (
                model,
                [
                    _without(record, outputs, mask)
                    for record, mask in zip(records, wrong, strict=True)
                ],
            )
            for model, records in (first, second)
        )
        old, new = fits_at_lowest_minimum(
            _layout(first, outputs, local), _layout(second, outputs, local)
        )
    if (
        old is None
        or new is None
        or not np.all(np.isfinite([*old.variance, *new.variance]))
        or min(*old.variance, *new.variance) <= 0.0
    ):
        return Compared(0.0, "a fit has no finite likelihood")
    if any(fit.counts.sum() <= len(fit.theta) for fit in (old, new)):
        # The residuals are rounding errors.
        return Compared(0.0, "as many unknowns as samples")
    if reason := _why_undecided(old, first) or _why_undecided(new, second):
        return Compared(0.0, reason)
    if np.min(new.variance / old.variance) > (1.0 - least) ** 2:
        return Compared(0.0)
    valid = [problem.valid for problem in old.layout.problems]
    return Compared(log_likelihood_gain(old.residuals, new.residuals, valid))


def from_trim(record: Record, model: Model) -> Record:
    """Return the record with its controls counted from trim, or from their mean without a trim.

    Inputs of equations of total motion are not changed. In equations of perturbations, the biases
    would otherwise have to absorb the response to the trim deflection; nothing else changes.
    """
    if of_totals(model):
        return record
    trimmed, _ = about_trim(record)
    centred = [
        channel
        if channel.name in MEASURED_MOTION or not lacks_trim(trimmed[channel.name])
        else Channel.of(channel.name, channel.unit, channel.values - np.mean(channel.values))
        for channel in trimmed.inputs
    ]
    return replace(trimmed, inputs=tuple(centred)) if centred != list(trimmed.inputs) else trimmed


def implausible_bias(value: float, measured: np.ndarray) -> bool:
    """Return whether the bias of an output cannot be its trim value; ``measured``: ``(N,)``.

    A trim value is not farther from the range of the samples than the length of that range. It is
    outside the range if the motion is on one side of trim only.
    """
    low, high = float(np.min(measured)), float(np.max(measured))
    length = high - low
    return not low - length <= value <= high + length


def _why_undecided(fit: Fit, interpretation: Interpretation) -> str:
    """Return the reason why a fit cannot decide on its interpretation; else an empty text."""
    if fit.outcome is not Outcome.CONVERGED:
        return "a fit has not converged"
    if of_totals(interpretation[0]):
        return ""
    for r, problem in enumerate(fit.layout.problems):
        known, _ = fit.layout.split(fit.theta, r)
        values = dict(zip(fit.layout.system.parameters.names, known.tolist(), strict=True))
        for i, name in enumerate(fit.layout.system.output_names):
            bias = values.get(f"bias_{name}", 0.0)
            if (
                np.any(problem.valid[i])
                and f"bias_{name}" in values
                and implausible_bias(bias, problem.z[i, problem.valid[i]])
            ):
                unit = interpretation[1][r][name].unit
                return (
                    f"a fit needs a bias of {name} of {bias:.3g} {unit}, far outside the range of "
                    "its samples"
                )
    return ""


def _wrong_samples(*fits: Fit | None) -> list[np.ndarray]:
    """Return isolated wrong samples of each record by either fit, booleans of shape ``(m, N)``.

    Empty if a fit is missing or has a residual that is not finite.
    """
    if any(
        fit is None or not all(np.all(np.isfinite(rows)) for rows in fit.residuals) for fit in fits
    ):
        return []
    finite = [fit for fit in fits if fit is not None]
    problems = finite[0].layout.problems
    masks = [np.zeros_like(problem.valid) for problem in problems]
    edges = [input_edges(problem.record) for problem in problems]
    measured = [
        i for i in range(len(masks[0])) if any(np.any(problem.valid[i]) for problem in problems)
    ]
    for fit in finite:
        for i in measured:
            wrong = isolated_wrong_samples(
                [rows[i] for rows in fit.residuals],
                [problem.valid[i] for problem in problems],
                edges,
            )
            for mask, wrong_in_record in zip(masks, wrong, strict=True):
                mask[i] |= wrong_in_record
    return masks


def _without(record: Record, outputs: Sequence[str], wrong: np.ndarray) -> Record:
    """Return the record without the wrong samples of its outputs, booleans of shape ``(m, N)``."""
    masks = {name: row for name, row in zip(outputs, wrong, strict=True) if np.any(row)}
    channels = tuple(
        replace(channel, valid=channel.valid & ~masks[channel.name])
        if channel.name in masks
        else channel
        for channel in record.outputs
    )
    return replace(record, outputs=channels)


def log_likelihood_gain(
    before: Sequence[np.ndarray], after: Sequence[np.ndarray], valid: Sequence[np.ndarray]
) -> float:
    """Return twice the log likelihood ratio of the second residuals to the first.

    Each sample is weighted by the share of independent samples (effective number over number), and
    each output has one noise level. Zero if a record contradicts the sum of all records.

    Parameters
    ----------
    before, after : residuals of the outputs, shape ``(m, N)`` for each record.
    valid : whether each sample counts, shape ``(m, N)`` for each record.
    """
    gains = np.zeros(len(valid))
    for i in range(len(valid[0])):
        valid_rows = [mask[i : i + 1] for mask in valid]
        share = min(
            effective_share([rows[i : i + 1] for rows in residuals], valid_rows)
            for residuals in (before, after)
        )
        for k, (row,) in enumerate(valid_rows):
            old = float(np.sum(before[k][i, row] ** 2))
            new = float(np.sum(after[k][i, row] ** 2))
            count = int(np.count_nonzero(row))
            if count and old > 0.0 and new > 0.0:
                gains[k] += share * count * np.log(old / new)
    total = float(np.sum(gains))
    if np.min(gains * np.sign(total)) < -CONTRADICTING_LOG_LIKELIHOOD_RATIO:
        return 0.0
    return total


def with_hold(records: Sequence[Record], hold: Hold) -> list[Record]:
    """Return the records with inputs held or linear between samples."""
    return [record if record.hold is hold else replace(record, hold=hold) for record in records]


def held_by_computer(record: Record) -> bool:
    """Return whether every input is exactly constant most of the time and changes in single steps.

    Such inputs are commands of a computer.
    """
    return all(_in_single_steps(np.diff(channel.values)) for channel in record.inputs)


def _in_single_steps(steps: np.ndarray) -> bool:
    """Return whether an input is mostly constant and moves in single steps.

    ``steps``: differences of its samples, shape ``(N - 1,)``. A surface in motion has several steps
    in one direction.
    """
    moves = steps != 0.0
    continued = moves[1:] & moves[:-1] & (np.sign(steps[1:]) == np.sign(steps[:-1]))
    continued_share = float(np.sum(continued)) / max(1.0, float(np.sum(moves)))
    mostly_constant = np.mean(moves) < 1.0 - UNMOVED_STEP_SHARE
    return bool(mostly_constant and continued_share < CONTINUED_STEP_SHARE)


def gain_of_linear_inputs(
    records: Sequence[Record],
    model: Model,
    interpret: Callable[[Model, list[Record]], Interpretation],
) -> float:
    """Return twice the log likelihood ratio of linear to held inputs; zero if undecided.

    ``interpret`` returns the interpretation of a model and records.
    """
    if not model.equations.inputs or all(held_by_computer(record) for record in records):
        return 0.0
    compared = _first_records(records)
    outputs = _outputs(compared, model)
    if not outputs:
        return 0.0
    held = interpret(model, with_hold(compared, Hold.PREVIOUS))
    linear = interpret(model, with_hold(compared, Hold.LINEAR))
    return compared_interpretations(held, linear, outputs).gain


def _layout(
    interpretation: Interpretation, outputs: Sequence[str], local: Collection[str]
) -> FitLayout:
    model, records = interpretation
    biased = model.with_biases(outputs_with_bias(model, outputs))
    settings = replace(
        COMPARISON_SETTINGS, max_step=sub_step(model, records, COMPARISON_SETTINGS.max_step)
    )
    return lay_out(records, compile_model(biased, list(outputs)), settings, local=local)


def _outputs(records: Sequence[Record], model: Model) -> list[str]:
    return [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in records)
    ]


def _first_records(records: Sequence[Record]) -> list[Record]:
    """Return the first records, until they have ``MOST_COMPARED_SAMPLES`` samples."""
    first, count = [], 0
    for record in records:
        first.append(record)
        count += len(record)
        if count >= MOST_COMPARED_SAMPLES:
            break
    return first
