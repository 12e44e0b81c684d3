"""R, P0 and the start of the fourteen-state filter follow the paper's rules."""

from __future__ import annotations

import numpy as np
import pytest

from ident.filters.problem import filter_problem
from scenarios.identification.low_order import (
    ENGINEERING_STD,
    PAPER_START,
    loes_filter_system,
)
from sim.vehicles.factory import model_from_constants
from tests import loes_problem as problem
from tests.bases import LOES_CONSTANTS


def test_fourteen_states_with_the_papers_variances() -> None:
    flown = problem.record(1, duration=3.0)
    system = loes_filter_system(
        model_from_constants("loes", LOES_CONSTANTS, PAPER_START), flown, problem.NOISE, {"q": 1e-6}
    )
    laid_out = filter_problem(flown, system, float("inf"))
    std = dict(zip(laid_out.names, np.sqrt(np.diag(laid_out.covariance)), strict=True))
    start = dict(zip(laid_out.names, laid_out.start, strict=True))
    assert len(laid_out.names) == 14 and "delay" not in std
    assert (
        std["alpha"] == problem.NOISE["alpha"]
        and std["q"] == problem.NOISE["q"]
        and std["delta"] == ENGINEERING_STD["delta"]
    )
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        assert std[name] == pytest.approx(abs(PAPER_START[name]) / 4.0)
    for name in ("L_delta", "L_q", "L_0", "M_0", "delta_0", "nz_0"):
        assert std[name] == pytest.approx(ENGINEERING_STD[name])
    assert start["nz_0"] == flown["nz"].values[0] and start["delta"] == flown["stick"].values[0]
    np.testing.assert_allclose(np.sqrt(laid_out.variance), list(problem.NOISE.values()))
    assert (
        dict(zip(laid_out.names, laid_out.density, strict=True))["q"] == 1e-6
        and np.count_nonzero(laid_out.density) == 1
    )
