"""Errors are compared with the estimated sensor noise; a residual that is not white has a column of
its own, and bands show the noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import FittedRecord, Verdict
from ident.tracing.whiteness import noise_floors
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.report.content import diagnosis_content
from scenarios.diagnosis.report.files import diagnosis_page, pictured
from scenarios.diagnosis.report.tables import errors_table
from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.report.html import page_html
from scenarios.report.terminal import cell_text
from sim.record import Channel, Record
from tests.diagnoses import NOISE, tracing_of

DEGREE = math.pi / 180.0


def coloured(verdict: Verdict) -> Tracing:
    """A diagnosis whose fit leaves twice the noise."""
    tracing = tracing_of(verdict)
    left = {name: 2.0 * std for name, std in tracing.diagnosis.residual_std.items()}
    return replace(tracing, diagnosis=replace(tracing.diagnosis, residual_std=left))


def test_a_white_residual_is_the_noise_and_has_no_column_of_its_own() -> None:
    told = diagnosis_text(tracing_of(Verdict.TRACED))
    assert "estimated sensor noise" in told and "noise floor" not in told
    headings = [
        column.heading for column in errors_table(tracing_of(Verdict.TRACED).diagnosis, "").columns
    ]
    assert headings[-1] == "sensor noise (estimated)" and "residual" not in headings


@pytest.mark.parametrize("verdict", [Verdict.PARTIAL, Verdict.UNEXPLAINED])
def test_of_a_coloured_residual_the_noise_is_told_apart(verdict: Verdict) -> None:
    tracing = coloured(verdict)
    d = tracing.diagnosis
    shown = errors_table(d, "")
    headings = [column.heading for column in shown.columns]
    assert headings[-2:] == ["residual", "sensor noise (estimated)"]
    rows = {str(row[0]): [cell_text(cell) for cell in row] for row in shown.rows}
    assert rows["q"][-1] == f"{NOISE['q'] / DEGREE:.3g}"
    if verdict is Verdict.PARTIAL:
        assert rows["q"][-2] == f"{2.0 * NOISE['q'] / DEGREE:.3g}"
    for told in (diagnosis_text(tracing), page_html(diagnosis_page(tracing, []))):
        assert "noise floor" not in told and "sensor noise (estimated)" in told
    assert pictured(tracing).noise["q"] == NOISE["q"], "bands of figures are those of the noise"


def test_the_json_has_both_and_under_unexplained_the_residual_of_the_declared_model() -> None:
    error = diagnosis_content(coloured(Verdict.PARTIAL), "now")["error"]
    assert error["noise_floor"]["q"] == NOISE["q"] and error["residual"]["q"] == 2.0 * NOISE["q"]
    tracing = coloured(Verdict.UNEXPLAINED)
    said = diagnosis_content(tracing, "now")["error"]["residual"]["q"]
    parts = [
        item.before[item.channels.index("q")][
            item.used[item.channels.index("q")] & item.record["q"].valid
        ]
        for item in tracing.diagnosis.fitted
    ]
    assert said == pytest.approx(float(np.sqrt(np.mean(np.concatenate(parts) ** 2))), rel=1e-12)


def test_the_floor_is_the_fits_level_where_white_and_the_sensors_where_coloured() -> None:
    rng, count = np.random.default_rng(3), 1000
    time, noise = np.arange(count) * 0.02, rng.standard_normal((2, count))
    left = noise + np.array([[0.0], [3.0]]) * np.sin(2.0 * np.pi * 0.2 * time)
    record = Record(
        time,
        (),
        tuple(Channel.of(name, "rad", np.zeros(count)) for name in ("alpha", "theta")),
        name="r",
    )
    fitted = (
        FittedRecord(record, ("alpha", "theta"), left, left, np.ones((2, count), dtype=bool)),
    )
    levels = {"alpha": 1.0, "theta": float(left[1].std())}
    tests = [
        ResidualTest("ljung-box", "alpha", 20.0, 0.5, "white"),
        ResidualTest("ljung-box", "theta, record 1", 900.0, 0.0, "not white"),
    ]
    floors = noise_floors(fitted, tests, levels)
    assert (
        floors["alpha"] == 1.0
        and floors["theta"] == pytest.approx(1.0, abs=0.1)
        and levels["theta"] > 2.0
    )
    assert noise_floors(fitted, tests, {"theta": 0.5}) == {"theta": 0.5}, (
        "no noise is larger than the residual"
    )
