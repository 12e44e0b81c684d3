"""Error figures by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.statistics.residuals import error_figures
from sim.record import Channel, Record


def record_of(rows: dict[str, np.ndarray]) -> Record:
    count = len(next(iter(rows.values())))
    return Record(
        0.02 * np.arange(count),
        (),
        tuple(Channel.of(name, "1", values) for name, values in rows.items()),
    )


FINITE = st.floats(-100.0, 100.0).map(lambda v: round(v, 3))


@given(
    st.lists(st.tuples(FINITE, FINITE, st.booleans()), min_size=5, max_size=40),
    st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=20),
)
@settings(max_examples=60)
def test_error_figures_are_the_textbook_formulas_over_all_records(
    first: list[tuple[float, float, bool]], second: list[tuple[float, float]]
) -> None:
    z1, p1, kept = (np.array(column) for column in zip(*first, strict=True))
    z2, p2 = (np.array(column) for column in zip(*second, strict=True))
    kept = kept.astype(bool)
    z, p = np.concatenate([z1[kept], z2]), np.concatenate([p1[kept], p2])
    records = [record_of({"q": z1}), record_of({"q": z2})]
    figures = error_figures(
        [p1[None], p2[None]], records, [kept[None], np.ones((1, len(z2)), dtype=bool)], ["q"]
    )
    residual_squares, total_squares = np.sum((z - p) ** 2), np.sum((z - np.mean(z)) ** 2)
    rmse = np.sqrt(residual_squares / len(z))
    assert figures.rmse["q"] == pytest.approx(rmse, rel=1e-9, abs=1e-12)
    if total_squares > 1e-9:
        assert figures.nrmse["q"] == pytest.approx(rmse / np.std(z), rel=1e-6)
        assert figures.r2["q"] == pytest.approx(
            1.0 - residual_squares / total_squares, rel=1e-6, abs=1e-9
        )
    size = np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(p**2))
    if size > 0:
        assert figures.theil["q"] == pytest.approx(rmse / size, rel=1e-9, abs=1e-12)
        assert 0.0 <= figures.theil["q"] <= 1.0 + 1e-12


def test_error_figures_of_what_is_not_there() -> None:
    """A channel at rest has no spread; one without a sample kept has no figures; one that a record
    lacks is taken from the others.
    """
    flat = record_of({"q": np.full(6, 2.0), "nz": np.arange(6.0)})
    other = record_of({"q": np.full(6, 2.0)})
    masks = [np.array([[True] * 6, [False] * 6]), np.array([[True] * 6, [False] * 6])]
    figures = error_figures(
        [np.full((2, 6), 2.5), np.full((2, 6), 1.5)], [flat, other], masks, ["q", "nz"]
    )
    assert figures.rmse == {"q": pytest.approx(0.5)}
    assert figures.nrmse == {"q": 0.0} and figures.r2 == {"q": 0.0}
    assert set(figures.theil) == {"q"}
