"""filterpy is imported without SciPy's statistics, and lacks nothing afterwards; each case in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

FILTERED = """
import sys
import numpy as np
from ident.filters.filterpy_import import extended_kalman_filter
ekf = extended_kalman_filter()(dim_x=2, dim_z=1)
ekf.predict()
ekf.update(np.array([[1.0]]), lambda x: np.array([[1.0, 0.0]]), lambda x: x[:1])
assert abs(ekf.x[0, 0] - 2.0 / 3.0) < 1e-12
"""
CASES = {
    "without scipy.stats": "assert 'scipy.stats' not in sys.modules and 'scipy.ndimage' not in sys.modules",
    "its likelihood": "assert abs(ekf.log_likelihood + 0.5 * (np.log(2 * np.pi * 3) + 1 / 3)) < 1e-12",
    "its class": "import filterpy.kalman; assert type(ekf) is filterpy.kalman.ExtendedKalmanFilter",
    "a package by import": "from filterpy.stats import gaussian; from filterpy.discrete_bayes import normalize; gaussian(0.0, 0.0, 1.0)",
    "a package by attribute": "import filterpy; assert filterpy.stats.gaussian(0.0, 0.0, 1.0) > 0.39 and filterpy.discrete_bayes.normalize",
    "a name it has not": "import filterpy; assert not hasattr(filterpy, 'nothing')",
}


@pytest.mark.parametrize("case", list(CASES))
def test_filterpy_after_its_import(case: str) -> None:
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", FILTERED + CASES[case]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_filterpy_that_was_imported_before_is_used_as_it_is() -> None:
    text = "import filterpy.stats\nbefore = filterpy.stats\n" + FILTERED + "assert filterpy.stats is before"
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
