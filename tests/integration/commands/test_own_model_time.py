"""A user's own model whose equations use the time, by every command that takes a model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.integration.command_line import CommandLine

TRUE = {"k": 4.0, "c": 0.5, "b": 1.0, "a": 0.6}
TIMED = '''"""A mass on a spring: a force that swings with the time, and a load from 6 s on."""

import numpy as np

from sim.declaration import own_model
from sim.maths import where

MODEL = own_model(
    name="timed",
    states={"x": "m", "v": "m/s"},
    inputs={"force": "N"},
    outputs={"x": "m", "v": "m/s"},
    parameters={"k": (3.2, "1/s2"), "c": (0.4, "1/s"), "b": (0.8, "m/s2"), "a": (0.4, "m/s2")},
    rates=lambda s, p: {
        "x": s.v,
        "v": s.force - p.c * s.v - p.k * s.x + p.b * np.cos(1.3 * s.time) + where(s.time > 6.0, p.a, 0.0),
    },
    readings=lambda s, p: {"x": s.x, "v": s.v},
)
'''  # noqa: E501


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The model's file and a record of it, simulated by SciPy."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "timed.py").write_text(TIMED)
    time = np.arange(0.0, 12.01, 0.02)
    force = 1.5 * ((time > 1) & (time < 2.5)) - 1.5 * ((time > 4) & (time < 5))
    rows = [np.zeros(2)]
    for at in range(len(time) - 1):

        def rates(t: float, x: np.ndarray, push: float = float(force[at])) -> list[float]:
            load = TRUE["b"] * np.cos(1.3 * t) + TRUE["a"] * (t > 6.0)
            return [x[1], push - TRUE["c"] * x[1] - TRUE["k"] * x[0] + load]

        rows.append(
            solve_ivp(rates, (time[at], time[at + 1]), rows[-1], rtol=1e-8, atol=1e-10).y[:, -1]
        )
    measured = np.array(rows) + np.array([0.004, 0.008]) * np.random.default_rng(5).standard_normal(
        (len(time), 2)
    )
    np.savetxt(
        tmp_path / "record.csv",
        np.column_stack([time, force, measured]),
        delimiter=",",
        header="time,force,x,v",
        comments="",
    )
    return tmp_path


@pytest.mark.sampled
@pytest.mark.parametrize("method", ["output-error", "equation-error", "ekf", "ukf", "filter-error"])
def test_every_method_in_the_time_domain_finds_the_parameters(
    flightid: CommandLine, folder: Path, method: str
) -> None:
    flightid.done(
        "identify",
        "record.csv",
        "--model",
        "timed.py",
        "--method",
        method,
        "--out",
        "out",
        "--no-figures",
    )
    found = json.loads((folder / "out" / "comparison.json").read_text())
    # The record has no process noise, so filter error cannot determine its scale.
    assert found["outcome"] == ("not-identifiable" if method == "filter-error" else "converged")
    for name, true in TRUE.items():
        assert (
            abs(found["parameters"][name]["estimate"] - true)
            < 4.0 * found["parameters"][name]["std"]
        ), name


def test_the_frequency_domain_refuses_it_in_one_line(flightid: CommandLine, folder: Path) -> None:
    said = flightid.refused(
        "identify", "record.csv", "--model", "timed.py", "--method", "frequency-domain"
    )
    assert (
        "the rate of v is no linear function of states and inputs" in said
        and "use output-error" in said
    )


@pytest.mark.long
def test_the_other_commands_take_it(flightid: CommandLine, folder: Path) -> None:
    assert "CONSISTENT" in flightid.done(
        "diagnose", "record.csv", "--model", "timed.py", "--no-figures"
    )
    flightid.done("simulate", "--model", "timed.py", "--out", "new.csv")
    for method in ("output-error", "ekf", "ukf", "equation-error"):
        assert "2 of 2 runs" in flightid.done(
            "campaign", "--model", "timed.py", "--runs", "2", "--set", f"estimate.method={method}"
        )
    assert "units: all known" in flightid.done("models", "timed.py")
    flightid.done("identify", "record.csv", "--model", "timed.py", "--out", "out", "--no-figures")
    assert "free simulation" in flightid.done("predict", "out", "record.csv", "--model", "timed.py")


def test_an_error_of_the_model_itself_is_reported_with_its_line(
    flightid: CommandLine, folder: Path
) -> None:
    text = TIMED.replace(
        "np.cos(1.3 * s.time)",
        "np.cos(1.3 * s.time) * (1.0 if np.size(s.x) < 3 else np.ones(3)[s.nowhere])",
    )
    (folder / "timed.py").write_text(text)
    said = flightid.refused("identify", "record.csv", "--model", "timed.py")
    assert "there is no signal s.nowhere" in said and "timed.py, line" in said
