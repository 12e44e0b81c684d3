"""Records that several tests of replication share."""

from __future__ import annotations

import pytest

from ident.tracing.replication.by_record import Flight
from sim.effects.sensor_path.sensor_delay import SensorDelay
from tests.tracing_problem import all_records, coloured, planted


@pytest.fixture(scope="package")
def late() -> Flight:
    """Three coloured records with alpha 80 ms late."""
    values = {"sensor-delay:alpha.delay": 0.08}
    return all_records([coloured(planted([SensorDelay("alpha")], values, seed), seed) for seed in (1, 2, 3)])
