"""Lab 2: the short period of a bomber from a 3-2-1-1, and the excitation that it needs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import row_of, scenario_study, sigmas_off

if TYPE_CHECKING:
    from scenarios.studies.study import StudyResult

SCENARIO = "rigid"
OUTPUTS = {"alpha and q": '["alpha", "q"]', "alpha alone": '["alpha"]', "q alone": '["q"]'}
# omega T at the maximum of a doublet's spectrum, sin(omega T / 2)^2 / omega: tan(x) = 2 x at
# x = omega T / 2.
PEAK_OF_DOUBLET = 2.3311


def changes(
    kind: str = "3-2-1-1",
    amplitude: float = 6.0,
    unit: float = 0.5,
    rate: int = 100,
    outputs: str = "alpha and q",
) -> tuple[str, ...]:
    """Return the changes of the scenario.

    They are kind of maneuver, amplitude (deg), unit (s), samples per second, and outputs used.
    """
    return (
        "flight.duration=12 s",
        f"flight.rate={rate:d} Hz",
        f"flight.maneuvers.1.kind={kind}",
        f"flight.maneuvers.1.amplitude={amplitude:g} deg",
        f"flight.maneuvers.1.unit={unit:g} s",
        f"estimate.outputs={OUTPUTS[outputs]}",
    )


def study(changed: tuple[str, ...], seed: int = 1) -> StudyResult:
    """Return the study with these changes."""
    return scenario_study(SCENARIO, changed, seed)


def largest_alpha(found: StudyResult) -> float:
    """Return the largest angle of attack from trim without noise, deg."""
    return float(np.degrees(np.max(np.abs(found.truth.outputs["alpha"]))))


def key_numbers(
    kind: str = "3-2-1-1",
    amplitude: float = 6.0,
    unit: float = 0.5,
    rate: int = 100,
    outputs: str = "alpha and q",
    seed: int = 1,
) -> dict[str, float]:
    """Return the numbers of the key: sigmas, errors in sigmas, frequency and damping."""
    found = study(changes(kind, amplitude, unit, rate, outputs), seed)
    rows = {row.name: row for row in found.main.rows}
    frequency, damping = (
        found.main.derived["natural_frequency"],
        found.main.derived["damping_ratio"],
    )
    shares = {
        f"sigma of {name}, %": 100.0 * row.std / abs(row.true or math.nan)
        for name, row in rows.items()
    }
    return {
        **shares,
        "error of Cm_alpha, sigmas": sigmas_off(rows["Cm_alpha"]),
        "frequency": frequency[0],
        "sigma of frequency, %": 100.0 * frequency[1] / frequency[0],
        "damping": damping[0],
        "largest alpha": largest_alpha(found),
        "tests failed": float(sum(not test.passed for test in found.main.tests)),
    }


def longest_unit(limit: float) -> float:
    """Return the longest unit (s) whose 3-2-1-1 of 6 deg keeps alpha within ``limit`` (deg).

    Units from 0.1 to 1.2 s are simulated, in steps of 0.1 s.
    """
    units = [0.1 * step for step in range(1, 13)]
    kept = [unit for unit in units if largest_alpha(study(changes(unit=round(unit, 1)))) <= limit]
    return round(max(kept), 1)


def tuned_doublet(frequency: float) -> float:
    """Return the unit (s) of the doublet whose spectrum peaks at a frequency (rad/s)."""
    return PEAK_OF_DOUBLET / frequency


def sigma_ratio(first: tuple[str, ...], second: tuple[str, ...]) -> float:
    """Return the sigma of Cm_alpha with the second changes over that with the first."""
    return row_of(study(second).main, "Cm_alpha").std / row_of(study(first).main, "Cm_alpha").std
