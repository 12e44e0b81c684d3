"""Streams that are regressed in the frequency domain: how inputs move between rows, and a measured
airspeed.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.frequency_domain.online import frequencies
from scenarios.files.vehicles import VehicleFile
from scenarios.watching.spectral import (
    SpectralSession,
    regress,
    spectral_content,
    spectral_session,
    take,
)
from sim.declaration.compile import compile_model
from sim.record import Hold
from tests import bases

FREE = bases.rigid_model().parameters.free_names
OUTPUTS = ("alpha", "q", "nz")
NOISE = (5e-4, 1e-3, 5e-3)


def followed(
    hold: Hold = Hold.PREVIOUS,
    *,
    speed: float | None = None,
    streamed: bool = True,
    given: Hold | None = None,
    pressure: bool = False,
) -> SpectralSession:
    """A stream of the rigid aircraft to its end, flown at ``speed``; ``streamed``: with it."""
    time = np.arange(600) / 20.0
    elevator = np.deg2rad(2.0) * (np.sin(0.9 * time) * np.sin(0.31 * time) + np.sin(4.0 * time))
    values = {} if speed is None else {"airspeed": speed}
    model = bases.rigid_model().with_values(values)
    flight = bases.Flight(time, elevator[None], hold=hold)
    rng = np.random.default_rng(3)
    rows = np.array(bases.fly(compile_model(model), flight))
    rows += np.array(NOISE)[:, None] * rng.standard_normal(rows.shape)
    absent = np.full(len(time), np.nan)
    air = bases.RIGID_VALUES["air_density"]
    flow = [absent, absent]
    if streamed and speed is not None:
        measured = speed + 0.3 * rng.standard_normal(len(time))
        flow = [absent, 0.5 * air * measured**2] if pressure else [measured, absent]
    constants = {k: v for k, v in bases.RIGID_VALUES.items() if k not in FREE}
    vehicle = VehicleFile(
        "rigid", "rigid", constants, {name: 1.2 * bases.RIGID_VALUES[name] for name in FREE}
    )
    names = [*OUTPUTS]
    if streamed and speed is not None:
        names.append("dynamic_pressure" if pressure else "airspeed")
    session = spectral_session(vehicle, "stream.csv", names, frequencies(), given)
    take(session, np.vstack([time, elevator, rows, *flow]))
    regress(session)
    return session


def off(session: SpectralSession, name: str) -> float:
    """Error of a parameter as a share of its value."""
    assert session.last is not None
    at = session.names.index(name)
    return abs(float(session.last.values[at]) / bases.RIGID_VALUES[name] - 1.0)


@pytest.mark.parametrize("hold", [Hold.PREVIOUS, Hold.LINEAR])
def test_the_rows_decide_how_inputs_move(hold: Hold) -> None:
    session = followed(hold)
    assert session.hold is hold
    assert off(session, "Cm_de") < 0.01
    notes = spectral_content(session).get("notes", [])
    assert (hold is Hold.LINEAR) == any("inputs linear between samples" in each for each in notes)


def test_linear_inputs_read_as_held_bias_the_control_power() -> None:
    session = followed(Hold.LINEAR, given=Hold.PREVIOUS)
    assert session.hold is Hold.PREVIOUS
    assert off(session, "Cm_de") > 0.02
    assert "inputs held between samples: as given by the user" in spectral_content(session)["notes"]


@pytest.mark.parametrize("pressure", [False, True])
def test_a_measured_airspeed_is_used(pressure: bool) -> None:
    """Twelve per cent faster than the vehicle file says, coefficients would be a quarter too
    large.
    """
    fast = 1.12 * bases.RIGID_VALUES["airspeed"]
    session = followed(speed=fast, pressure=pressure)
    assert max(off(session, name) for name in ("Cm_alpha", "Cm_de", "CL_alpha")) < 0.02
    content = spectral_content(session)
    assert any("used" in each and "m/s (declared" in each for each in content["notes"])
    assert any("is far from" in each for each in content["warnings"])
    blind = followed(speed=fast, streamed=False)
    assert off(blind, "Cm_alpha") > 0.15
    assert "warnings" not in spectral_content(blind)
