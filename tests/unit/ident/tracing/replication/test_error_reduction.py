"""By how much the error on records that were not fitted falls, against changes of known size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.error_reduction import _block_sums, reduction
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


def test_errors_are_resampled_by_blocks_of_a_second_and_a_half(late: Flight) -> None:
    """Errors that are gone over whole seconds scatter by what whole seconds do: more than those of samples that are gone here and there."""
    fitted = root_of(late)
    record = late.records[0]
    frozen = held_out(fitted, [record], None, informed=False).frozen
    assert frozen is not None
    blocks = _block_sums(frozen, frozen)
    assert blocks.shape == (-(-len(record) // round(thresholds.BLOCK / 0.02)), 2, 3)
    np.testing.assert_allclose(blocks.sum(axis=0), np.tile(np.sum(frozen.residuals[0] ** 2, axis=1), (2, 1)))
    seconds = (record.time // 1.5) % 2 == 0
    scattered = np.random.default_rng(1).random(len(record)) < 0.5
    scatter = [
        reduction([frozen], [replace(frozen, weighted=replace(frozen.weighted, residuals=(frozen.residuals[0] * np.where(left, 1.0, 0.3),)))]).scatter
        for left in (seconds, scattered)
    ]
    assert scatter[0] > 2.0 * scatter[1]
