"""Terms of six coefficients chosen among sixty."""

from __future__ import annotations

import numpy as np

from benchmarks.comparison.agreement import same_estimates
from benchmarks.comparison.job import Contender, Job, Problem

MANEUVERS, WINDOWS, TERMS, AXES, PRESENT = 50, 200, 60, 6, 6
NOISE = 0.3


def problem(small: bool) -> Problem:
    """Columns of terms and noisy coefficients of many maneuvers.

    ``columns (N, 60)``, the first a constant, the others of variance one and correlated in pairs;
    ``coefficients (6, N)``, each of six terms; ``maneuver (N,)`` numbers from 0; ``noise (1,)``;
    ``true (360,)``, coefficient by coefficient.
    """
    rng = np.random.default_rng(8)
    maneuvers = 5 if small else MANEUVERS
    count = maneuvers * WINDOWS
    columns = rng.standard_normal((count, TERMS))
    columns[:, 2::2] += 0.5 * columns[:, 1:-1:2]
    columns /= np.std(columns, axis=0)
    columns[:, 0] = 1.0
    true = np.zeros((AXES, TERMS))
    for row in true:
        at = [0, *(1 + rng.choice(TERMS - 1, PRESENT - 1, replace=False))]
        row[at] = rng.uniform(0.4, 1.5, PRESENT) * rng.choice([-1.0, 1.0], PRESENT)
    noise = NOISE * rng.standard_normal((AXES, count))
    return {
        "columns": columns,
        "coefficients": true @ columns.T + noise,
        "maneuver": np.repeat(np.arange(maneuvers), WINDOWS),
        "noise": np.array([NOISE]),
        "true": true.ravel(),
    }


JOB = Job(
    "structure",
    "Structure determination",
    """Six coefficients, sixty terms offered to each, six of them present; averages of 50 maneuvers. flightid also predicts each maneuver by the
others at each step. pysindy's thresholded least squares is told a threshold that suits these numbers; it has neither F ratios nor sigmas.
aeroid (0.5.0) chooses no terms; it is a peer of output error.
All end with plain least squares of the terms chosen.""",  # noqa: E501
    Contender("flightid_structure", "flightid, stepwise regression", "flightid"),
    (
        Contender(
            "scipy_stepwise",
            "SciPy, forward selection in a loop",
            "scipy",
            ("scipy",),
            tolerance=0.1,
        ),
        Contender("pysindy_structure", "pysindy, STLSQ", "pysindy", ("pysindy",), tolerance=0.1),
    ),
    problem,
    same_estimates,
)
