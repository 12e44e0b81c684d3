"""Flexibility of an aircraft: static condensation, stiffness factors, and adequacy of a rigid
model.

Condensation of all modes. With etadot = eta_ddot = 0 the modal equations (eq. 28 of the paper on
simulated flight data) are linear in eta,

    omega_i^2 M_i / (qbar S c) eta_i - sum_j Ceta_i_eta_j eta_j = Ceta_i_alpha alpha + Ceta_i_q
    q_hat + Ceta_i_de elevator,

and the terms of eta in CL and Cm change the six rigid derivatives.

Condensation of the upper modes b. The motion and the kept modes a deflect them at once, etadot_b =
eta_ddot_b = 0,

    (K_b - C_bb) eta_b = C_b_motion motion + C_ba eta_a + C_ba_dot etadot_a c/2V,

and the terms of eta_b in CL, Cm and the forces on the kept modes change the coefficients of the
reduced model.

A rigid model with equivalent derivatives assumes that the structure follows its loads at once. The
error of this assumption increases with frequency (in proportion to it at low frequencies, because
of the rates of the modes). It decreases with the square of the modal frequencies.

Degree of flexibility (analytic, no data needed): the error of this assumption at the condensed
short period, eps = max over alpha and q of |Y_flexible(j omega_sp) / Y_condensed(j omega_sp) - 1|,
where Y is the response to the elevator.

Criterion (for a maneuver and a noise): the six rigid derivatives are fitted to the noise-free
flexible response. ``misfit`` is the rms of the residual of the best rigid model, each channel over
its noise standard deviation. A rigid model is adequate if misfit <= 1: the error of its prediction
is then smaller than that of the sensor. With a larger misfit the structure dominates the residual.
Taking this residual for noise means assuming more noise than the sensor has (the paper does so for
its second aircraft, with a variance of 0.09 instead of 0.016 deg^2).

An adequate rigid model may still leave a detectable misfit. ``detectable`` is the misfit above
which a residual test on n numbers detects the structure, about misfit^2 n = 2 z sqrt(2 n) with z =
1.645 (5 % false alarms, 95 % power of a chi-squared test on the energy). Between the two limits the
rigid fit is good, but its derivatives, ``fitted``, differ from the condensed ones by more than
their sigmas. ``distance`` bounds this bias. By the inequality of Cauchy and Schwarz, to first order
no combination of derivatives differs by more sigmas than the whole response.

Values for the bomber with all four modes, the 3-2-1-1 of 6 deg and unit 0.5 s, 8 s at 100 Hz, noise
variance 0.016 deg^2 in alpha and q (factor: common factor on AC1's frequencies; AC2 is 0.5):

    factor  omega_1  stiffness lost  separation  degree  distance  misfit  rigid is adequate
    8       100.6    0.004           51.2        0.0005     0.9    0.01    yes, undetected
    4        50.3    0.015           25.7        0.0018     3.5    0.03    yes, undetected
    2        25.1    0.058           13.1        0.0071    14.3    0.14    yes, undetected
    1 AC1    12.57   0.211            7.1        0.0296    63.1    0.69    yes, detected (0.34 on)
    0.9      11.3    0.255            6.6        0.0373    88.4    1.25    no
    0.7       8.80   0.397            5.6        0.0674   219.9    4.27    no
    0.5 AC2   6.29   0.720            5.8        0.1603   510.9    9.62    no

For this maneuver and noise the threshold is near factor 0.93, a degree of 0.035. The separation
alone is no measure, because the frequency of the short period falls with those of the modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.declaration.model import Model
from sim.errors import DeclarationError, ModelError
from sim.vehicles.factory import (
    RIGID_DERIVATIVES,
    flexible_model,
    frequency_response,
    linearise,
    rigid_model,
    zero_order_hold_response,
)
from sim.vehicles.library import Origin, VehicleData

# ---- Static condensation

_MOTIONS = ("alpha", "q", "de")


@dataclass(frozen=True)
class Condensation:
    """Result of a static condensation.

    Attributes
    ----------
    derivatives : equivalent ``CL_alpha CL_q CL_de Cm_alpha Cm_q Cm_de``, 1/rad.
    change : equivalent minus rigid value, by the same names.
    deflection : ``(n, 3)`` static eta of each mode per alpha (rad), q_hat (q c/2V, rad) and
        elevator (rad).
    divergence_margin : smallest eigenvalue of I - K^-1 C_eta_eta: 1 without aerodynamic stiffness,
        0 at static divergence of the restrained structure.
    """

    derivatives: Mapping[str, float]
    change: Mapping[str, float]
    deflection: np.ndarray
    divergence_margin: float


def condense(values: Mapping[str, float], modes: int) -> Condensation:
    """Condense the first ``modes`` elastic modes of an aircraft.

    Parameters
    ----------
    values : numbers by full name in SI, as ``VehicleData.values`` has them; a coupling that is
        missing is zero.
    modes : number of modes that are condensed; 0 returns the rigid derivatives.

    Raises
    ------
    ModelError : the restrained structure is beyond static divergence, so that it has no static
        deflection.
    """
    numbers = range(1, modes + 1)
    stiffness, aerodynamic = _stiffness(values, numbers)
    margin = (
        float(np.min(np.linalg.eigvals(np.eye(modes) - aerodynamic / stiffness[:, None]).real))
        if modes
        else 1.0
    )
    if margin <= 0:
        raise ModelError(
            f"static divergence: the margin is {margin:.3g}",
            where=f"{modes} elastic mode(s)",
            remedy="raise the frequencies or lower the airspeed",
        )
    forces = _table(values, [f"Ceta{i}" for i in numbers], _MOTIONS)
    deflection = np.linalg.solve(np.diag(stiffness) - aerodynamic, forces)
    loads = ("CL", "Cm")
    rigid = _table(values, loads, _MOTIONS)
    change = _table(values, loads, [f"eta{i}" for i in numbers]) @ deflection
    names = [f"{load}_{motion}" for load in loads for motion in _MOTIONS]
    return Condensation(
        dict(zip(names, (rigid + change).ravel().tolist(), strict=True)),
        dict(zip(names, change.ravel().tolist(), strict=True)),
        deflection,
        margin,
    )


def condense_above(values: Mapping[str, float], modes: int, kept_modes: int) -> dict[str, float]:
    """Return the coefficients of a model with ``kept_modes`` modes that is equivalent to one with
    ``modes`` modes in static deflection.

    Parameters
    ----------
    values : as in ``condense``.
    modes : number of modes of the aircraft.
    kept_modes : number of modes of the reduced model, ``0 <= kept_modes <= modes``. Without any the
        result is that of ``condense``.

    Returns
    -------
    The six rigid derivatives and, of the kept modes, their ``CL_eta CL_etadot Cm_eta Cm_etadot``
    and all ``Ceta``, SI.

    Raises
    ------
    ModelError : more modes are to be kept than there are.
    """
    if not 0 <= kept_modes <= modes:
        raise ModelError(
            f"{kept_modes} modes kept of {modes}", where="condensation", remedy=f"keep 0 to {modes}"
        )
    kept, condensed = range(1, kept_modes + 1), range(kept_modes + 1, modes + 1)
    rows = ["CL", "Cm", *(f"Ceta{i}" for i in kept)]
    columns = [*_MOTIONS, *(f"eta{j}" for j in kept), *(f"etadot{j}" for j in kept)]
    stiffness, aerodynamic = _stiffness(values, condensed)
    forces = _table(values, [f"Ceta{i}" for i in condensed], columns)
    deflection = np.linalg.solve(np.diag(stiffness) - aerodynamic, forces)
    by_deflection = _table(values, rows, [f"eta{i}" for i in condensed])
    reduced = _table(values, rows, columns) + by_deflection @ deflection
    return {
        f"{row}_{column}": float(value)
        for row, line in zip(rows, reduced, strict=True)
        for column, value in zip(columns, line, strict=True)
    }


def _table(values: Mapping[str, float], rows: Sequence[str], columns: Sequence[str]) -> np.ndarray:
    """Return the coefficients ``ROW_COLUMN``; a coupling between modes that is missing is zero."""

    def coefficient(row: str, column: str) -> float:
        coupling = row.startswith("Ceta") and column.startswith("eta")
        name = f"{row}_{column}"
        return values.get(name, 0.0) if coupling else values[name]

    return np.array([[coefficient(row, column) for column in columns] for row in rows]).reshape(
        len(rows), len(columns)
    )


def _stiffness(values: Mapping[str, float], modes: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the structural stiffness ``(n,)`` of modes and their aerodynamic stiffness ``(n, n)``,
    both over qbar S c.
    """
    pressure = (
        0.5
        * values["air_density"]
        * values["airspeed"] ** 2
        * values["wing_area"]
        * values["chord"]
    )
    structural = [
        values[f"omega{i}"] ** 2 * values[f"generalized_mass{i}"] / pressure for i in modes
    ]
    forces, deflections = [f"Ceta{i}" for i in modes], [f"eta{i}" for i in modes]
    return np.array(structural), _table(values, forces, deflections)


# ---- The same aircraft with a stiffer or softer structure


def with_frequency_factor(data: VehicleData, factor: float) -> VehicleData:
    """Return a vehicle with in-vacuo modal frequencies ``factor`` times those of ``data``.

    Masses, shapes and damping ratios are equal. Modal stiffness is proportional to the square of
    the factor; a large factor gives a rigid aircraft. A factor of 1 returns the same object.

    Raises
    ------
    DeclarationError : the factor is not above zero; or it is not one and the vehicle has no elastic
        modes.
    """
    if factor == 1.0:
        return data
    if not (factor > 0.0 and math.isfinite(factor)):
        raise DeclarationError(
            f"a frequency factor of {factor:g}",
            where=f"vehicle {data.name}",
            remedy="give a number above zero",
        )
    if not data.modes:
        raise DeclarationError(
            "it has no modal frequencies",
            where=f"vehicle {data.name}",
            remedy="leave the frequency factor out",
        )
    scaled = {f"omega{i}" for i in range(1, data.modes + 1)}
    note = f"{factor:g} times that of {data.name}"
    return replace(
        data,
        numbers=tuple(
            replace(number, value=factor * number.value, origin=Origin.OWN, note=note)
            if number.name in scaled
            else number
            for number in data.numbers
        ),
    )


# ---- Degree of flexibility, and adequacy of a rigid model

LARGEST_MISFIT = 1.0  # largest misfit of an adequate rigid model
_NORMAL_95 = 1.6448536269514722  # 95 % quantile of the standard normal distribution
_ITERATIONS = 30  # most iterations of the fit of a rigid model


@dataclass(frozen=True)
class Flexibility:
    """Figures of an aircraft's flexibility, which the module defines.

    Attributes
    ----------
    stiffness_loss : share of the short period's stiffness omega_sp^2 that static deflection
        removes.
    separation : lowest elastic frequency divided by the condensed short-period frequency.
    short_period : condensed short-period frequency omega_sp, rad/s.
    degree : degree of flexibility, the error of the quasi-static assumption at ``short_period``.
    distance : root of the sum of squares over the record of the flexible minus the condensed
        response, divided by the noise.
    misfit : rms over the record of the residual of the best rigid model, divided by the noise.
    detectable : misfit above which a residual test detects the structure.
    condensed, fitted : six derivatives by condensation, and those of the best rigid model for this
        maneuver, 1/rad.
    """

    stiffness_loss: float
    separation: float
    short_period: float
    degree: float
    distance: float
    misfit: float
    detectable: float
    condensed: Mapping[str, float]
    fitted: Mapping[str, float]

    @property
    def rigid_serves(self) -> bool:
        """Whether a rigid model is adequate for this maneuver and noise."""
        return self.misfit <= LARGEST_MISFIT


def flexibility(
    data: VehicleData,
    elevator: np.ndarray,
    step: float,
    noise_std: Mapping[str, float],
    modes: int | None = None,
) -> Flexibility:
    """Return the figures of flexibility for a maneuver and a noise.

    Parameters
    ----------
    data : a vehicle with elastic modes.
    elevator : ``(N,)``, rad, held between samples.
    step : sampling interval, s.
    noise_std : output -> standard deviation of its noise; other outputs do not count.
    modes : number of modes of the flexible model; None for all.

    Raises
    ------
    ModelError : no output is named; the condensed aircraft has no oscillatory short period; or
        static divergence.
    """
    if not noise_std:
        raise ModelError(
            "no output is named",
            where="flexibility",
            remedy="give the noise standard deviation of at least one output",
        )
    flexible, condensed = _pair(data, modes)
    outputs, scale = list(noise_std), np.array([noise_std[name] for name in noise_std])[:, None]

    def response(model: Model) -> np.ndarray:
        return (zero_order_hold_response(linearise(model, outputs), elevator, step) / scale).ravel()

    names = [*RIGID_DERIVATIVES]
    values = dict(zip(names, condensed.parameters.values(names).tolist(), strict=True))
    target, at_condensed = response(flexible), response(condensed)
    fitted, misfit = _best_rigid(condensed, names, response, target)
    short_period = _short_period(data, condensed)
    rigid_short_period = _short_period(data, rigid_model(data))
    elastic = sorted(abs(root) for root in _oscillations(flexible))[1:]
    return Flexibility(
        stiffness_loss=1.0 - (short_period / rigid_short_period) ** 2,
        separation=elastic[0] / short_period if elastic else math.inf,
        short_period=short_period,
        degree=_error(flexible, condensed, short_period),
        distance=float(np.linalg.norm(target - at_condensed)),
        misfit=misfit / math.sqrt(target.size),
        detectable=math.sqrt(2.0 * _NORMAL_95 * math.sqrt(2.0 * target.size) / target.size),
        condensed=values,
        fitted=fitted,
    )


def _pair(data: VehicleData, modes: int | None) -> tuple[Model, Model]:
    """Return the flexible model, and the rigid model with the condensed derivatives."""
    chosen = data.modes if modes is None else modes
    return flexible_model(data, chosen), rigid_model(data).with_values(
        condense(data.values, chosen).derivatives
    )


def _error(flexible: Model, condensed: Model, omega: float) -> float:
    """Return the relative error of the condensed model's frequency responses at ``omega``."""
    exact, approximate = (
        frequency_response(linearise(model, ("alpha", "q")), omega)[:, 0]
        for model in (flexible, condensed)
    )
    return float(np.max(np.abs(exact / approximate - 1.0)))


def _oscillations(model: Model) -> list[complex]:
    """Return the eigenvalues of a model with a positive imaginary part, 1/s."""
    return [root for root in np.linalg.eigvals(linearise(model).A).tolist() if root.imag > 0]


def _short_period(data: VehicleData, model: Model) -> float:
    """Return the short-period frequency of a rigid model, rad/s."""
    roots = _oscillations(model)
    if not roots:
        raise ModelError(
            "has no oscillatory short period",
            where=f"vehicle {data.name}",
            remedy="raise the modal frequencies",
        )
    return float(abs(roots[0]))


def _best_rigid(
    start: Model, names: Sequence[str], response: Callable[[Model], np.ndarray], target: np.ndarray
) -> tuple[dict[str, float], float]:
    """Return the derivatives of the best rigid model, and the norm of its residual.

    They are found by Gauss-Newton steps from the condensed derivatives. A step that does not reduce
    the residual is halved.
    """
    model, error = start, target - response(start)
    for _ in range(_ITERATIONS):
        values = model.parameters.values(names)
        sizes = 1e-6 * np.maximum(1.0, np.abs(values))
        residual = target - error
        columns = [
            (response(model.with_values({name: value + size})) - residual) / size
            for name, value, size in zip(names, values, sizes, strict=True)
        ]
        move = np.linalg.lstsq(np.array(columns).T, error, rcond=None)[0]
        share = 1.0
        while share > 1e-3:
            tried = model.with_values(dict(zip(names, values + share * move, strict=True)))
            left = target - response(tried)
            if np.linalg.norm(left) < np.linalg.norm(error):
                break
            share *= 0.5
        else:
            break
        gain = 1.0 - np.linalg.norm(left) / np.linalg.norm(error)
        model, error = tried, left
        if gain < 1e-8:
            break
    return dict(zip(names, model.parameters.values(names).tolist(), strict=True)), float(
        np.linalg.norm(error)
    )
