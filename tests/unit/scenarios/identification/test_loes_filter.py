"""R, P0 and the start of the fourteen-state filter follow the paper's rules."""

from __future__ import annotations

import numpy as np
import pytest

from ident.filters.problem import filter_problem
from scenarios.identification.low_order import (
    ENGINEERING_STD,
    PAPER_START,
    about_trim,
    loes_filter_system,
)
from sim.errors import RecordError
from sim.record import Channel, Record
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


def test_total_angles_become_perturbations_about_trim() -> None:
    flown = problem.record(2, duration=3.0, gaps=True)
    outputs = tuple(Channel.of(c.name, c.unit, c.with_gaps() + 0.07) for c in flown.outputs)
    inputs = tuple(Channel.of(c.name, c.unit, c.values + 0.2) for c in flown.inputs)
    moved = about_trim(Record(flown.time, inputs, outputs), 0.9)
    np.testing.assert_allclose(moved["stick"].values, flown["stick"].values, atol=1e-12)
    shift = moved["alpha"].values - flown["alpha"].values
    assert np.ptp(shift[flown["alpha"].valid]) < 1e-12 and abs(shift[0]) < 0.001
    np.testing.assert_array_equal(moved["q"].valid, flown["q"].valid)
    np.testing.assert_allclose(moved["nz"].values[:40], flown["nz"].values[:40] + 0.07)
    with pytest.raises(RecordError, match="no sample up to -1 s"):
        about_trim(flown, -1.0)
