"""Lab 3: a rigid model of a flexible aircraft with a stiffer or softer structure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flightid.labs.workings import ALONE, row_of, sigmas_off, tried

if TYPE_CHECKING:
    from scenarios.studies.study import StudyResult

SCENARIO = "flexible-ac1-equivalent"
DENSITIES = (0.0, 0.03, 0.1, 0.15, 0.3, 0.6, 1.0)  # (deg/s)^2/s on pitch rate
OF_ALPHA = "0.003 deg^2/s"  # process noise of alpha with each of these, except zero
MODES = (12.57, 14.07, 21.17, 22.05)  # rad/s in vacuo, from `flightid vehicles bomber_ac1`


def changes(factor: float = 1.0, density: float = 0.0, unit: float = 0.5) -> tuple[str, ...]:
    """Return the changes of the scenario.

    They are a factor on all modal frequencies, the filter's process noise of pitch rate
    ((deg/s)^2/s), and the unit of the 3-2-1-1 (s).
    """
    process_noise = f'{{alpha = "{OF_ALPHA}", q = "{density:g} (deg/s)^2/s"}}' if density else "{}"
    return (
        ALONE,
        f"flight.frequency_factor={factor:g}",
        f"flight.maneuvers.1.unit={unit:g} s",
        f"estimate.process_noise={process_noise}",
    )


def study(changed: tuple[str, ...], seed: int = 1) -> StudyResult:
    """Return the study of the flexible aircraft, estimated with a rigid model."""
    return tried(SCENARIO, changed, seed)


def marks(factor: float) -> list[float]:
    """Return the frequencies of the elastic modes, rad/s."""
    return [factor * mode for mode in MODES]


def numbers(
    factor: float = 1.0, density: float = 0.0, unit: float = 0.5, seed: int = 1
) -> dict[str, float]:
    """Return the numbers of the key.

    They are the loss of each derivative in percent of its rigid value, errors against the condensed
    values in sigmas, and the number of failed tests.
    """
    found = study(changes(factor, density, unit), seed)
    rows = {row.name: row for row in found.main.rows}
    lost = {
        f"{name} lost, %": 100.0 * (1.0 - row.estimate / row.true)
        for name, row in rows.items()
        if row.true
    }
    return {
        **lost,
        **{f"error of {name}, sigmas": sigmas_off(row) for name, row in rows.items()},
        "sigma of Cm_q": rows["Cm_q"].std,
        "within 3 sigmas": float(sum(abs(sigmas_off(row)) <= 3.0 for row in rows.values())),
        "tests failed": float(sum(not test.passed for test in found.main.tests)),
        "frequency": found.main.derived["natural_frequency"][0],
    }


def nearer() -> str:
    """Return whether the estimate of Cm_alpha is nearer to the rigid or to the condensed value."""
    row = row_of(study(changes()).main, "Cm_alpha")
    assert row.true is not None and row.condensed is not None
    is_rigid = abs(row.estimate - row.true) < abs(row.estimate - row.condensed)
    return "rigid" if is_rigid else "condensed"


def worst(factor: float = 1.0) -> str:
    """Return the derivative with the largest error against its condensed value, in sigmas."""
    return max(study(changes(factor)).main.rows, key=lambda row: abs(sigmas_off(row))).name


def first_seen() -> float:
    """Return the first structure, from stiff to soft, whose residual test fails."""
    factors = (4.0, 3.0, 2.0, 1.5, 1.0)
    return next(factor for factor in factors if numbers(factor)["tests failed"] > 0)


def enough_noise() -> float:
    """Return the smallest of the densities with which no residual test fails."""
    return next(d for d in DENSITIES if numbers(density=d)["tests failed"] == 0)
