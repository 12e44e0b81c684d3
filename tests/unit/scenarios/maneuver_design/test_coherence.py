"""Maneuvers for frequency responses: limits of the rate without clipping, coherence as it will
be.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import flightid as fid
from scenarios.cli import main
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.limits import no_faster
from scenarios.maneuver_design.report import design_text
from scenarios.maneuver_design.setting import (
    KINDS,
    DesignRequest,
    ManeuverLimits,
    multisines,
    sweeps,
)
from scenarios.plots.maneuvers import figure_coherence
from sim.declaration.compile import compile_model
from sim.maths import complex_step_jacobian
from tests.figure_laws import broken_laws, words
from tests.unit.scenarios.maneuver_design.test_design import VEHICLE

BAND = (0.2, 3.0)


def typed(*command: str | Path) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in command])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("coherence") / "vehicle.toml"
    path.write_text(VEHICLE)
    return path


@pytest.fixture(scope="module")
def planned(vehicle: Path) -> DesignResult:
    return design(
        DesignRequest(
            "rigid",
            vehicle,
            {"elevator_rate": "20 deg/s"},
            band=BAND,
            noise=("alpha=0.002", "q=0.01"),
            computer=True,
        )
    )


def room(
    corners: tuple[float, ...] = (), inputs: int = 2, band: tuple[float, float] | None = None
) -> ManeuverLimits:
    return ManeuverLimits(np.arange(3001) / 50.0, 0.5, inputs, corners, band)


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["sweep", "multisine"])
@pytest.mark.parametrize("band", [None, (1.0, 15.0)])
def test_a_limit_of_the_rate_cuts_nothing_off(kind: str, band: tuple[float, float] | None) -> None:
    corners = (3.0, 4.0)
    limited, free = (KINDS[kind](room(each, band=band), 0.2) for each in (corners, ()))
    assert limited is not None and free is not None
    fastest = np.max(np.abs(np.diff(limited, axis=1)), axis=1) * 50.0
    assert np.all(fastest <= np.array(corners) * (1.0 + 1e-9)) and np.all(
        np.max(np.abs(limited), axis=1) <= 1.0 + 1e-12
    )
    np.testing.assert_allclose(no_faster(limited, np.array(corners), 0.02), limited, atol=1e-12)
    assert np.all(np.max(np.abs(np.diff(free, axis=1)), axis=1) * 50.0 > np.array(corners))
    np.testing.assert_allclose(np.max(np.abs(free), axis=1), 1.0)


def test_multisines_stay_orthogonal_under_a_limit_of_the_rate() -> None:
    """Over the period no input has power at a harmonic of the other, slow or not."""
    one = room((3.0, 5.0), band=(0.8, 12.0))
    rows = multisines(one, 0.2)
    assert rows is not None
    begin = round(one.lead * 50.0)
    count = math.floor(one.active * 50.0 + 1e-9)
    power = np.abs(np.fft.rfft(rows[:, begin : begin + count], axis=1)) ** 2
    large = power > 1e-12 * power.max()
    assert not np.any(large[0] & large[1]) and large.sum() > 40
    at = np.flatnonzero(large.any(axis=0)) * 2.0 * math.pi / (count / 50.0)
    assert at[0] >= 0.8 * 0.9 and at[-1] <= 12.0 * 1.05
    # Amplitudes fall as one over the frequency above the corner.
    sizes = np.sqrt(power[0][large[0]])
    omega = np.flatnonzero(large[0]) * 2.0 * math.pi / (count / 50.0)
    np.testing.assert_allclose(
        sizes / sizes[0], np.minimum(1.0, 3.0 / omega) / min(1.0, 3.0 / omega[0]), rtol=1e-6
    )


def test_a_sweep_covers_the_band_and_no_more() -> None:
    rows = sweeps(room(inputs=1, band=(2.0, 12.0)), 0.2)
    assert rows is not None
    power = np.abs(np.fft.rfft(rows[0])) ** 2
    at = 2.0 * math.pi * np.fft.rfftfreq(rows.shape[1], 0.02)
    inside = (at >= 0.8 * 2.0) & (at <= 1.2 * 12.0)
    assert power[inside].sum() > 0.97 * power.sum()


@pytest.fixture(scope="module")
def louder(vehicle: Path) -> DesignResult:
    """With noise that decides the coherence, not the change of a sweep's frequency within a
    window.
    """
    return design(
        DesignRequest(
            "rigid",
            vehicle,
            {"elevator_rate": "20 deg/s"},
            band=BAND,
            noise=("alpha=0.012", "q=0.06"),
            computer=True,
        )
    )


def test_coherence_is_what_the_power_of_output_and_noise_gives(louder: DesignResult) -> None:
    """Written a second way: Welch's spectrum of the input, the short period's response, white
    noise.
    """
    setting = louder.setting
    system = compile_model(setting.model, list(setting.noise))
    p, still = system.parameters.values().tolist(), system.initial.values().tolist()
    A = complex_step_jacobian(lambda x: system.f(0.0, x, [0.0], p), still)
    B = complex_step_jacobian(lambda u: system.f(0.0, still, u, p), [0.0])
    for each in louder.maneuvers:
        found = each.responses
        assert found is not None and found.outputs == ("alpha", "q")
        size = round(
            5.0 / setting.maneuver_limits.interval
        )  # short enough for a window at the end of a sweep
        at, power = signal.welch(
            each.flight.deflections[0], 1.0 / setting.maneuver_limits.interval, nperseg=size
        )
        inside = (at > 0.6) & (at < 2.4)
        s = 2j * math.pi * at[inside]
        for row, noise in enumerate((0.012, 0.06)):
            response = np.linalg.solve(s[:, None, None] * np.eye(2) - A, B.astype(complex)[None])[
                :, row, 0
            ]
            answer = np.abs(response) ** 2 * power[inside]
            expected = answer / (answer + 2.0 * noise**2 * setting.maneuver_limits.interval)
            shown = np.interp(at[inside], found.frequency, found.coherence[row, 0])
            # Coherences of few windows are biased upwards, those of a sweep within a window
            # downwards.
            assert np.median(np.abs(shown - expected)) < 0.1, (each.kind, row)


@pytest.mark.long
def test_a_flight_of_it_has_the_coherence_that_was_said(planned: DesignResult) -> None:
    """The designed input, flown with fresh noise, through the command's own estimate."""
    best = planned.best
    clean = np.array(best.flight.motion.fit.linearisations[0].y)
    rng = np.random.default_rng(99)
    said = best.responses
    assert said is not None
    shares = []
    for _ in range(6):
        noisy = clean + np.array([[0.002], [0.01]]) * rng.standard_normal(clean.shape)
        columns = {
            "time": planned.setting.maneuver_limits.time,
            "de": best.flight.deflections[0],
            "a": noisy[0],
            "pitch": noisy[1],
        }
        flown = fid.frequency_response(
            columns,
            "de",
            ["a", "pitch"],
            band=(float(said.frequency[0]), float(said.frequency[-1])),
        )
        shares.append(np.interp(said.frequency, flown.frequency, flown.coherence[1]))
    assert np.max(np.abs(np.mean(shares, axis=0) - said.coherence[1, 0])) < 0.15
    assert np.median(np.abs(np.mean(shares, axis=0) - said.coherence[1, 0])) < 0.03


def test_more_noise_makes_worse_responses(louder: DesignResult, planned: DesignResult) -> None:
    assert louder.best.responses is not None and planned.best.responses is not None
    assert louder.best.responses.criterion > 1.2 * planned.best.responses.criterion
    assert np.all(
        louder.best.responses.coherence.mean(axis=2) < planned.best.responses.coherence.mean(axis=2)
    )
    assert planned.maneuvers[0].responses is not None and planned.maneuvers[1].responses is not None
    assert planned.maneuvers[0].responses.criterion <= planned.maneuvers[1].responses.criterion


@pytest.mark.long
def test_the_command_and_python(
    vehicle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan"
    command: list[str | Path] = [
        "design",
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--band",
        "0.2",
        "3",
        "--computer",
    ]
    assert typed(*command, "--out", out) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "frequency responses expected of one flight" in printed and "--band 0.2 3" in printed
    content = json.loads((out / "design.json").read_text())
    assert {each["kind"] for each in content["maneuvers"]} == {"sweep", "multisine"}
    pairs = content["maneuvers"][0]["responses"]["pairs"]
    assert [pair["output"] for pair in pairs] == ["alpha", "q", "nz"] and all(
        0.0 <= pair["usable"] <= 1.0 for pair in pairs
    )
    assert (out / "coherence.png").is_file() and "Expected frequency responses" in (
        out / "report.html"
    ).read_text()
    plan = fid.design("rigid", vehicle, band=(0.2, 3.0), computer=True)
    frame = plan.coherence("q", "elevator")
    assert frame["coherence"].tolist() == pairs[1]["coherence"]
    with pytest.raises(fid.InputError, match="there is no 'p'"):
        plan.coherence("p", "elevator")
    with pytest.raises(fid.InputError, match="no band is asked for"):
        fid.design("rigid", vehicle, duration=12.0).coherence("q", "elevator")


def test_laws_of_its_figure(planned: DesignResult) -> None:
    kinds = [(each.kind, each.responses) for each in planned.maneuvers]
    drawn = figure_coherence(kinds, "coherence expected")
    assert not broken_laws(drawn) and "multisine" in words(drawn)
    assert "usable" in design_text(planned)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--band", "3", "0.2"], "3 to 0.2 Hz is no band"),
        (["--band", "0.2", "3"], "a pilot does not follow a sweep to 3 Hz by hand"),
        (["--band", "0.01", "1"], "give 0.042 Hz or more, or --computer"),
        (["--band", "0", "2"], "0 to 2 Hz is no band"),
        (
            ["--band", "0.2", "3", "--computer", "--tell", "input-delay,actuator-lag"],
            "not by effects",
        ),
        (["--band", "0.2", "3", "--computer", "--rate", "20"], "too few for 3 Hz"),
        (["--band", "0.05", "3", "--computer", "--duration", "20"], "too short for 0.05 Hz"),
    ],
)
def test_bad_bands_are_one_line(
    vehicle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], said: str
) -> None:
    assert (
        typed("design", "--model", "rigid", "--vehicle", vehicle, *more, "--out", tmp_path / "plan")
        == 2
    )
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and said in shown.err
    assert not (tmp_path / "plan").exists()


def test_a_sweep_is_smaller_where_it_is_fast() -> None:
    """Peaks of single periods: full until the corner, then falling as one over the frequency."""
    one = room((4.0,), inputs=1, band=(1.0, 16.0))
    rows = sweeps(one, 0.2)
    assert rows is not None
    share = (one.time - one.lead) / one.active
    sizes = []
    for at in (0.25, 0.5, 0.75):  # 2, 4 and 8 rad/s
        near = np.abs(share - at) < 0.04 / at
        sizes.append(float(np.max(np.abs(rows[0][near]))))
    assert sizes[1] == pytest.approx(sizes[0], rel=0.15) and sizes[2] == pytest.approx(
        0.5 * sizes[0], rel=0.2
    )
