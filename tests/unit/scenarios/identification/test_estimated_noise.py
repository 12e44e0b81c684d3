"""Of an identification whose residual is coloured the sensor noise is told apart; of a white one
there is nothing to tell.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.identification.identify import identify
from scenarios.identification.report import estimated_noise, noise_phrase
from tests.every_model import case_of


def test_sensor_noise_is_told_apart_from_what_the_model_misses() -> None:
    case = case_of("own", 3)
    found = identify(case.record, case.vehicle, "output-error")
    assert estimated_noise(found) == {} and noise_phrase(found) == ""
    (fit,) = found.fits
    row, channel = fit.outputs.index("p"), fit.record["p"]
    noise = float(np.std(channel.values - fit.simulated[row]))
    missed = fit.simulated.copy()
    missed[row] += 3.0 * noise * np.sin(np.linspace(0.0, 20.0, len(fit.record)))
    failed = tuple(
        replace(test, p_value=1e-12) if test.channel == "p" else test for test in found.tests
    )
    coloured = replace(found, fits=(replace(fit, simulated=missed),), tests=failed)
    assert set(estimated_noise(coloured)) == {"p"} and estimated_noise(coloured)[
        "p"
    ] == pytest.approx(noise, rel=0.15)
    assert noise_phrase(coloured).startswith(
        "sensor noise (estimated from high frequencies, 1 sigma): p "
    )
