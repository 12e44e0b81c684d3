"""Printed examples rebuilt by frequency responses: poles, zeros, delays within what is printed.

The records are not public. A sweep is flown by the printed model, and what `frequency_response`
makes of it is compared with the printed values in units of the printed standard deviations.

- F. Bauer and D. Andrisani, "Estimating Short-Period Dynamics Using an Extended Kalman Filter",
  NASA TM-101722, 1990, table 1, simulation: a low-order equivalent with lag and delay.
- The rigid aircraft of the second paper that the scenarios `rigid` follow: true derivatives and
  standard deviations without process noise (docs/papers.md).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import flightid as fid
from tests import bases
from tests.rigid_problem import noisy

# Table 1 of NASA TM-101722, values and variances; the stick's sign is turned, the delay is that of
# the paper's frequency responses, with the step between the filters of its bank.
PRINTED = {
    "L_alpha": (-1.91, 0.385e-5**0.5),
    "M_alpha": (-12.4, 0.113e-1**0.5),
    "M_delta": (0.317, 0.120e-4**0.5),
    "M_q": (-2.99, 0.244e-2**0.5),
    "inv_tau": (10.6, 0.209e-1**0.5),
    "delay": (0.120, 0.0125),
}
HELD = {"L_delta": 2.49e-5, "L_q": 1.01}
RIGID = {
    "CL_alpha": (2.922, 0.00764),
    "CL_q": (-14.7, 0.75708),
    "CL_de": (0.435, 0.01976),
    "Cm_alpha": (-1.66, 0.00166),
    "Cm_q": (-34.75, 6.68809),
    "Cm_de": (-2.578, 0.00289),
}
DURATION, RATE = 300.0, 50.0


def flown(model: object, amplitude: float, names: tuple[str, ...], path: Path) -> Path:
    """A sweep of the model with a hundredth of its sensors' noise, as a record file."""
    time = np.arange(int(DURATION * RATE)) / RATE
    sweep = amplitude * signal.chirp(time, 0.08, DURATION, 4.0, method="logarithmic")
    record = noisy(
        model,  # type: ignore[arg-type]
        bases.Flight(time, sweep[None]),
        np.random.default_rng(1),
        scale=0.01,
    )
    columns = [time, sweep, *(record[name].values for name in names[1:])]
    header = ",".join(["time", *names])
    rows = np.column_stack(columns)
    np.savetxt(path, rows, fmt="%.12g", delimiter=",", header=header, comments="")
    return path


@pytest.mark.long
def test_the_low_order_equivalent_of_the_x29_simulation(tmp_path: Path) -> None:
    values = {name: value for name, (value, _) in PRINTED.items()} | HELD
    model = bases.loes_model(values)
    record = flown(model, 1.0, ("stick", "alpha", "q"), tmp_path / "sweep.csv")
    starts = {name: 1.2 * value for name, value in values.items() if name not in HELD} | HELD
    rows = [f"{name} = {value!r}" for name, value in starts.items()]
    constants = [f"{name} = {value!r}" for name, value in bases.LOES_CONSTANTS.items()]
    vehicle = tmp_path / "x29.toml"
    vehicle.write_text("\n".join(['name = "x29"', *constants, "[derivatives]", *rows]))
    found = fid.frequency_response(
        record,
        "stick",
        ["alpha", "q"],
        hold="previous",
        band=(0.1, 3.0),
        model="loes",
        vehicle=vehicle,
        fix=HELD,
    )
    fitted = found.details.model
    assert fitted is not None and fitted.fit.converged
    for name, (value, std) in PRINTED.items():
        assert abs(fitted.fit.as_dict[name] - value) < std, name
    # Poles and zero of q/stick.
    p = fitted.fit.as_dict
    squared = p["L_alpha"] * p["M_q"] - p["L_q"] * p["M_alpha"]
    damping = -(p["L_alpha"] + p["M_q"]) / (2.0 * squared**0.5)
    assert squared**0.5 == pytest.approx(4.27, abs=0.02)
    assert damping == pytest.approx(0.574, abs=0.01)


@pytest.mark.long
def test_the_derivatives_of_the_rigid_aircraft(tmp_path: Path) -> None:
    model = bases.rigid_model()
    names = ("elevator", "alpha", "q", "nz")
    record = flown(model, np.radians(2.0), names, tmp_path / "sweep.csv")
    v = bases.RIGID_VALUES
    constants = [f"{name} = {v[name]!r}" for name in v if not name.startswith("C")]
    rows = [f"{name} = {1.2 * v[name]!r}" for name in RIGID]
    vehicle = tmp_path / "rigid.toml"
    vehicle.write_text("\n".join(['name = "rigid"', *constants, "[derivatives]", *rows]))
    found = fid.frequency_response(
        record,
        "elevator",
        list(names[1:]),
        hold="previous",
        band=(0.1, 3.0),
        model="rigid",
        vehicle=vehicle,
        fix={"delay": 0.0},
    )
    fitted = found.details.model
    assert fitted is not None
    for name, (value, std) in RIGID.items():
        assert abs(fitted.fit.as_dict[name] - value) < std, name
