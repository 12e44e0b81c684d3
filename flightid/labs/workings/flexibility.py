"""Lab 3: a rigid model on the record of a flexible aircraft, whose structure is made stiffer or
softer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from flightid.labs.workings.trying import ALONE, row_of, sigmas_off, tried

if TYPE_CHECKING:
    from scenarios.studies.study import StudyResult

SCENARIO = "flexible-ac1-equivalent"
DENSITIES = (0.0, 0.03, 0.1, 0.15, 0.3, 0.6, 1.0)  # (deg/s)^2/s on pitch rate
OF_ALPHA = "0.003 deg^2/s"  # the scenario's own, beside any of these but none
MODES = (12.57, 14.07, 21.17, 22.05)  # rad/s in vacuo, as `flightid vehicles bomber_ac1` lists them


def changes(factor: float = 1.0, density: float = 0.0, unit: float = 0.5) -> tuple[str, ...]:
    """Changes of the scenario: factor of all modal frequencies, process noise of the filter on
    pitch rate ((deg/s)^2/s), unit of the 3-2-1-1 (s).
    """
    believed = f'{{alpha = "{OF_ALPHA}", q = "{density:g} (deg/s)^2/s"}}' if density else "{}"
    return (
        ALONE,
        f"flight.frequency_factor={factor:g}",
        f"flight.maneuvers.1.unit={unit:g} s",
        f"estimate.process_noise={believed}",
    )


def study(asked: tuple[str, ...], seed: int = 1) -> StudyResult:
    """One flight of the flexible aircraft, estimated with a rigid model."""
    return tried(SCENARIO, asked, seed)


def marks(factor: float) -> list[float]:
    """Frequencies of the elastic modes, rad/s."""
    return [factor * mode for mode in MODES]


def numbers(
    factor: float = 1.0, density: float = 0.0, unit: float = 0.5, seed: int = 1
) -> dict[str, float]:
    """What the key expects: shares of the rigid value that a derivative has lost, errors against
    the condensed values in sigmas, tests failed.
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


def nearer(factor: float = 1.0, name: str = "Cm_alpha") -> str:
    """Return whether an estimate is nearer to the rigid or to the condensed value."""
    row = row_of(study(changes(factor)).main, name)
    assert row.true is not None and row.condensed is not None
    return (
        "rigid" if abs(row.estimate - row.true) < abs(row.estimate - row.condensed) else "condensed"
    )


def worst(factor: float = 1.0) -> str:
    """The derivative that is most of its sigmas from its condensed value."""
    return max(study(changes(factor)).main.rows, key=lambda row: abs(sigmas_off(row))).name


def first_seen(factors: tuple[float, ...] = (4.0, 3.0, 2.0, 1.5, 1.0)) -> float:
    """Return the first structure, from stiff to soft, whose residual test fails."""
    return next(factor for factor in factors if numbers(factor)["tests failed"] > 0)


def enough_noise(factor: float = 1.0) -> float:
    """The least of the densities with which no test of the residual fails."""
    return next(density for density in DENSITIES if numbers(factor, density)["tests failed"] == 0)
