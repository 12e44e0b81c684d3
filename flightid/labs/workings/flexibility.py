"""Lab 3: a rigid model fitted to a flexible aircraft whose structure may be stiffer or softer.

Condensed values are the rigid derivatives plus the effect of elastic modes that follow at once
(equivalent derivatives in docs/nomenclature.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from flightid.labs.workings import MAIN_METHOD_ONLY, row_of, scenario_study, sigmas_off

if TYPE_CHECKING:
    from scenarios.studies.study import StudyResult

SCENARIO = "flexible-ac1-equivalent"
# process noise of pitch rate that a student may choose, (deg/s)^2/s
DENSITIES = (0.0, 0.03, 0.1, 0.15, 0.3, 0.6, 1.0)
ALPHA_PROCESS_NOISE = "0.003 deg^2/s"  # in addition, unless the process noise of pitch rate is zero
MODE_FREQUENCIES = (
    12.57,
    14.07,
    21.17,
    22.05,
)  # rad/s in vacuo, from `flightid vehicles bomber_ac1`


def changes(factor: float = 1.0, density: float = 0.0, unit: float = 0.5) -> tuple[str, ...]:
    """Return the changes of the scenario, as for the option ``--set``.

    Parameters
    ----------
    factor : factor on all modal frequencies.
    density : process noise of pitch rate in the filter, (deg/s)^2/s.
    unit : duration of the shortest pulse of the 3-2-1-1 maneuver, s.
    """
    process_noise = (
        f'{{alpha = "{ALPHA_PROCESS_NOISE}", q = "{density:g} (deg/s)^2/s"}}' if density else "{}"
    )
    return (
        MAIN_METHOD_ONLY,
        f"flight.frequency_factor={factor:g}",
        f"flight.maneuvers.1.unit={unit:g} s",
        f"estimate.process_noise={process_noise}",
    )


def study(changed: tuple[str, ...], seed: int = 1) -> StudyResult:
    """Return the study of the flexible aircraft, estimated with a rigid model."""
    return scenario_study(SCENARIO, changed, seed)


def mode_frequencies(factor: float) -> list[float]:
    """Return the in-vacuo frequencies of the elastic modes, rad/s, scaled by ``factor``."""
    return [factor * frequency for frequency in MODE_FREQUENCIES]


def key_numbers(
    factor: float = 1.0, density: float = 0.0, unit: float = 0.5, seed: int = 1
) -> dict[str, float]:
    """Return the numbers in the instructor's key of the lab, by their labels.

    Among them are, for each derivative, its loss in percent of the rigid value, and its error
    against the condensed value in sigmas. Parameters are those of `changes`, and the ``seed`` of
    the noise.
    """
    main = study(changes(factor, density, unit), seed).main
    rows = {row.name: row for row in main.rows}
    losses = {
        f"{name} lost, %": 100.0 * (1.0 - row.estimate / row.true)
        for name, row in rows.items()
        if row.true
    }
    return {
        **losses,
        **{f"error of {name}, sigmas": sigmas_off(row) for name, row in rows.items()},
        "sigma of Cm_q": rows["Cm_q"].std,
        "within 3 sigmas": float(sum(abs(sigmas_off(row)) <= 3.0 for row in rows.values())),
        "tests failed": float(sum(not test.passed for test in main.tests)),
        "frequency": main.derived["natural_frequency"][0],
    }


def nearer_reference() -> str:
    """Return the reference value to which the estimate of Cm_alpha is nearer: ``"rigid"`` or
    ``"condensed"``.
    """
    row = row_of(study(changes()).main, "Cm_alpha")
    assert row.true is not None and row.condensed is not None
    nearer_rigid = abs(row.estimate - row.true) < abs(row.estimate - row.condensed)
    return "rigid" if nearer_rigid else "condensed"


def worst_derivative(factor: float = 1.0) -> str:
    """Return the name of the derivative with the largest error, in sigmas, against its condensed
    value.
    """
    return max(study(changes(factor)).main.rows, key=lambda row: abs(sigmas_off(row))).name


def first_rejected_factor() -> float:
    """Return the first frequency factor, from stiff to soft, with which a residual test fails."""
    factors = (4.0, 3.0, 2.0, 1.5, 1.0)
    return next(factor for factor in factors if key_numbers(factor)["tests failed"] > 0)


def least_sufficient_density() -> float:
    """Return the smallest of ``DENSITIES`` with which no residual test fails."""
    return next(
        density for density in DENSITIES if key_numbers(density=density)["tests failed"] == 0
    )
