"""By how much the error on records that were not fitted falls, against changes of known size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.validation.held_out import held_out
from tests.tracing_problem import root_of


def test_reduction_counts_channels_alike_and_knows_its_scatter(late: Flight) -> None:
    """Against errors of known size: half of alpha's error taken away is ln(1/2)/3 over three channels."""
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    halved = [replace(fit, weighted=replace(fit.weighted, residuals=(fit.residuals[0] * np.array([[0.5], [1.0], [1.0]]),))) for fit in before]
    found = reduction(before, halved)
    assert found.total == pytest.approx(np.log(0.5) / 3.0) and found.share == pytest.approx(0.5 ** (1 / 3))
    assert found.by_channel == pytest.approx([np.log(0.5), 0.0, 0.0]) and found.scatter == pytest.approx(0.0, abs=1e-12)
    assert len(found.by_record) == 3
    # Errors that are exchanged at random between before and after change nothing but for scatter.
    rng = np.random.default_rng(3)
    shuffled = [replace(fit, weighted=replace(fit.weighted, residuals=(rng.permuted(fit.residuals[0], axis=1),))) for fit in before]
    assert abs(reduction(before, shuffled).total) < 3.0 * reduction(before, shuffled).scatter + 1e-9
