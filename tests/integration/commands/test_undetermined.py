"""Parameters that a record does not determine: what follows from them keeps a sigma that is right,
and none is zero or no number.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.integration.command_line import CommandLine

STIFFNESS, DAMPING = 4.0, 0.5
FREQUENCY, RATIO = 2.0, 0.125  # of x'' + 0.5 x' + 4 x
MODELS = {
    "a sum": (
        '"k": (3.0, "1/s2"), "k2": (0.5, "1/s2"), "c": (0.3, "1/s"), "c2": (0.1, "1/s")',
        "s.force - (p.c + p.c2) * s.v - (p.k + p.k2) * s.x",
    ),
    "a common factor": (
        '"m": (1.2, "kg"), "k": (3.0, "N/m"), "c": (0.3, "N s/m"), "b": (0.8, "1")',
        "(p.b * s.force - p.c * s.v - p.k * s.x) / p.m",
    ),
}
METHODS = ["output-error", "equation-error", "filter-error", "frequency-domain", "ekf", "ukf"]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mass on a spring pushed about, simulated by SciPy, with noise."""
    time = np.arange(0.0, 20.01, 0.02)
    force = 1.5 * ((time > 1) & (time < 2.5)) - 1.5 * ((time > 4) & (time < 5))
    rows = [np.zeros(2)]
    for at in range(len(time) - 1):

        def rates(t: float, x: np.ndarray, push: float = float(force[at])) -> list[float]:
            return [x[1], push - DAMPING * x[1] - STIFFNESS * x[0]]

        rows.append(
            solve_ivp(rates, (time[at], time[at + 1]), rows[-1], rtol=1e-9, atol=1e-11).y[:, -1]
        )
    measured = np.array(rows) + 0.005 * np.random.default_rng(2).standard_normal((len(time), 2))
    path = tmp_path_factory.mktemp("record") / "record.csv"
    np.savetxt(
        path,
        np.column_stack([time, force, measured]),
        delimiter=",",
        header="time,force,x,v",
        comments="",
    )
    return path


@pytest.mark.sampled
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", MODELS)
def test_modes_are_known_where_their_parameters_are_not(
    flightid: CommandLine, record: Path, tmp_path: Path, kind: str, method: str
) -> None:
    parameters, acceleration = MODELS[kind]
    model = tmp_path / "redundant.py"
    model.write_text(
        "from sim.declaration import own_model\n"
        'MODEL = own_model(name="redundant", states={"x": "m", "v": "m/s"}, inputs={"force": "N"}, '
        'outputs={"x": "m", "v": "m/s"},\n'
        f"    parameters={{{parameters}}},\n"
        f'    rates=lambda s, p: {{"x": s.v, "v": {acceleration}}}, readings=lambda s, p: {{"x": '
        f's.x, "v": s.v}})\n'
    )
    printed = flightid.done(
        "identify",
        record,
        "--model",
        model,
        "--method",
        method,
        "--out",
        tmp_path / "out",
        "--no-figures",
    )
    assert not re.search(r"\+- 0(\.0*)?\b(?!\.)(?![\d])", printed)
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    for quantity in (*found["parameters"].values(), *found["derived"].values()):
        assert quantity["std"] > 0.0
    if method in ("ekf", "ukf"):  # a filter has a prior of each parameter
        return
    assert found["outcome"] == "not-identifiable" and "does not determine all parameters" in printed
    for name, true in (("natural_frequency", FREQUENCY), ("damping_ratio", RATIO)):
        value, std = found["derived"][name]["estimate"], found["derived"][name]["std"]
        assert std < 0.02 * true
        if method != "equation-error":  # which noise in its regressors biases
            assert abs(value - true) < 4.0 * std


@pytest.mark.sampled
@pytest.mark.parametrize("method", METHODS)
def test_times_in_another_unit_end_in_an_outcome_or_one_line(
    flightid: CommandLine, tmp_path: Path, method: str
) -> None:
    # Times in nanoseconds read as seconds: propagated matrices leave the range of numbers.
    time = np.arange(201) * 0.04
    aileron = 0.05 * ((time > 1) & (time < 2)) - 0.05 * ((time > 2) & (time < 3))
    p = np.zeros(201)
    for k in range(200):
        p[k + 1] = np.exp(-0.08) * p[k] + 4.0 * (1.0 - np.exp(-0.08)) * aileron[k]
    p += 0.001 * np.random.default_rng(3).standard_normal(201)
    record, model = tmp_path / "record.csv", tmp_path / "roll.py"
    np.savetxt(
        record,
        np.column_stack([1e9 * time, aileron, p]),
        delimiter=",",
        header="time,aileron,p",
        comments="",
    )
    model.write_text(
        "from sim.declaration import own_model\n"
        'MODEL = own_model(name="roll", states={"p": "rad/s"}, inputs={"aileron": "rad"}, '
        'outputs={"p": "rad/s"},\n'
        '    parameters={"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")},\n'
        '    rates=lambda s, p: {"p": p.L_p * s.p + p.L_da * s.aileron}, readings=lambda s, p: '
        '{"p": s.p})\n'
    )
    call = flightid("identify", record, "--model", model, "--method", method)
    assert call.code in (0, 2), call.err
    assert "nan" not in call.out.lower().split() and "internal error" not in call.err
    assert call.code == 0 or len(call.err.strip().splitlines()) == 1
