"""What a design starts from: the pace of a model by its roots, sample times, limits."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenarios.identification.model_checks import PULSE_LENGTH_FACTOR
from scenarios.maneuver_design import report as report
from scenarios.maneuver_design.design import used_shares
from scenarios.maneuver_design.limits import (
    ACTUATOR_RATE,
    COMPUTER,
    ENGINE_RISE,
    PILOT,
    Limits,
    limits_of,
    usual_limits,
    with_usual_rates,
)
from scenarios.maneuver_design.report import maneuver_content
from scenarios.maneuver_design.setting import (
    INSTRUMENTS,
    DesignRequest,
    ManeuverLimits,
    _frequency,
    _limits_of,
    _refuse_band,
    _rounded,
    steps_in_turn,
    sweeps,
)
from sim.declaration import own_model
from sim.declaration.model import Model
from sim.errors import DeclarationError
from sim.maneuvers import doublet
from tests.bases import base_for, rigid_model

REST = {"push": 0.0}
ASKED = DesignRequest("rigid", Path("vehicle.toml"))


def chain(*roots: float) -> Model:
    """Separate first-order states of these roots (1/s)."""
    names = [f"x{i}" for i in range(len(roots))]
    return own_model(
        "chain",
        states=dict.fromkeys(names, "m"),
        inputs={"push": "m/s"},
        outputs={"x0": "m"},
        parameters={"gain": (1.0, "1")},
        rates=lambda s, p: {
            name: root * getattr(s, name) + p.gain * s.push
            for name, root in zip(names, roots, strict=True)
        },
        readings=lambda s, p: {"x0": s.x0},
    )


@pytest.mark.parametrize(
    ("roots", "frequency"),
    [
        ((-2.0, -8.0), 4.0),  # geometric, not arithmetic mean
        ((-3.0,), 3.0),
        ((2.0, -8.0), 4.0),  # an unstable root is as quick
        ((-1.0, -8.0, -8.0), 4.0),
        ((-2.0, -8.0, -0.7), 4.0),  # slower than a tenth of the quickest
        ((-8.0, -8.0, -1.0), 4.0),  # a little quicker than a tenth
        ((0.0, 0.0), 1.0),  # integrators alone have no pace
    ],
)
def test_the_pace_is_the_geometric_mean_of_the_quicker_roots(
    roots: tuple[float, ...], frequency: float
) -> None:
    assert _frequency(chain(*roots), REST) == pytest.approx(frequency)


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (3.0, 5.0), (5.0, 5.0), (51.0, 100.0), (0.012, 0.02)],
)
def test_a_rate_is_the_next_round_number_that_is_not_below(value: float, rounded: float) -> None:
    assert _rounded(value) == pytest.approx(rounded)


def test_an_own_model_is_flown_for_forty_pulses_with_twenty_samples_in_each() -> None:
    model = chain(-2.0)
    pulse = PULSE_LENGTH_FACTOR / _frequency(model, REST)
    room = _limits_of(ASKED, model, pulse)
    rate = 1.0 / room.interval
    assert pulse * rate * (1.0 + 1e-9) >= 20.0 and pulse * rate <= 20.0 * 2.5
    assert (
        room.time[0] == 0.0
        and room.time[-1] == pytest.approx(40.0 * pulse, abs=1.0 / rate)
        and room.time[-1] >= 40.0 * pulse - 1e-9
    )


def test_too_many_samples_are_refused_and_so_is_a_flight_too_short() -> None:
    model = chain(-2.0)
    with pytest.raises(DeclarationError, match="20001 samples"):
        _limits_of(DesignRequest("x", None, duration=20001.0, rate=1.0), model, 1.0)
    assert (
        len(_limits_of(DesignRequest("x", None, duration=20000.0, rate=1.0), model, 1.0).time)
        == 20001
    )
    with pytest.raises(DeclarationError, match="leave no room"):
        _limits_of(DesignRequest("x", None, duration=1.9, rate=10.0), model, 0.01)
    for asked, option in (
        (DesignRequest("x", rate=0.0), "--rate"),
        (DesignRequest("x", rate=math.inf), "--rate"),
        (DesignRequest("x", duration=-1.0), "--duration"),
    ):
        with pytest.raises(DeclarationError, match=f"{option}: .* is not above 0"):
            _limits_of(asked, model, 1.0)


DEGREE = math.pi / 180.0


@pytest.mark.parametrize(
    ("given", "output", "ends"),
    [
        ({"alpha_max": "3 deg"}, "alpha", (-3.0 * DEGREE, 3.0 * DEGREE)),
        ({"q_max": "9 deg/s"}, "q", (-9.0 * DEGREE, 9.0 * DEGREE)),
        ({"alpha_max": "3 deg", "alpha_min": "-1 deg"}, "alpha", (-1.0 * DEGREE, 3.0 * DEGREE)),
        ({"alpha_min": "-1 deg"}, "alpha", (-1.0 * DEGREE, 8.0 * DEGREE)),
        ({"nz_max": 1.6}, "nz", (0.0, 1.6)),
        ({"nz_min": 0.5}, "nz", (0.5, 2.0)),
    ],
)
def test_one_limit_of_an_angle_or_a_rate_holds_to_both_sides_and_of_a_load_factor_to_its_own(
    given: dict[str, Any], output: str, ends: tuple[float, float]
) -> None:
    model = rigid_model()
    usual = usual_limits(model, {"alpha": 0.0, "q": 0.0, "nz": 0.0})
    found = limits_of(given, model, usual)
    assert found.outputs[output] == pytest.approx(ends)
    assert {name: kept for name, kept in found.outputs.items() if name != output} == {
        name: kept for name, kept in usual.outputs.items() if name != output
    }


@pytest.mark.parametrize(
    ("low", "high", "share", "whose"),
    [
        (1.0, 1.3, 0.5, "nz"),
        (0.8, 1.0, 0.4, "nz"),
        (1.0, 1.6, 1.0, "nz"),
        (1.0, 1.9, 1.5, "nz"),
        (1.0, 1.03, 0.1, "alpha"),
    ],
)
def test_a_limit_is_used_up_from_the_rest_to_itself(
    low: float, high: float, share: float, whose: str
) -> None:
    """nz rests at 1 between 0.5 and 1.6; alpha uses a tenth of its own."""
    limits = Limits({"nz": (0.5, 1.6), "alpha": (-0.1, 0.3)}, {}, {})
    setting: Any = SimpleNamespace(
        limits=limits, still={"nz": 0.0, "alpha": 0.1, "q": 0.0}, model=rigid_model()
    )
    extremes = {"nz": (low, high), "alpha": (0.08, 0.12), "q": (-9.0, 9.0)}
    shares = used_shares(setting, extremes)
    assert max(shares, key=lambda name: shares[name]) == whose
    assert shares[whose] == pytest.approx(share) and shares["q"] == 0.0


def test_limits_that_the_rest_does_not_keep_are_refused() -> None:
    setting: Any = SimpleNamespace(
        limits=Limits({"nz": (1.1, 1.6)}, {}, {}), still={"nz": 0.0}, model=rigid_model()
    )
    with pytest.raises(DeclarationError, match="nz is 1 before any maneuver"):
        used_shares(setting, {"nz": (1.0, 1.2)})


@pytest.mark.parametrize(("bound", "shown"), [("alpha, nz", "alpha, nz"), ("", "amplitude")])
def test_a_maneuver_is_held_by_the_output_that_reaches_its_limit_else_by_its_amplitude(
    bound: str, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "peaks_of", lambda *_: {})
    flight = SimpleNamespace(
        scale=0.5, bound_by=bound, extremes={"alpha": (-0.1, 0.2)}, margins={"alpha": 0.5}
    )
    maneuver: Any = SimpleNamespace(
        kind="doublet",
        pulse_width=1.0,
        flight=flight,
        criterion=0.1,
        sigmas={"a": 1.0, "b": math.inf},
        contests=(),
        responses=None,
    )
    design: Any = None
    found = maneuver_content(design, maneuver)
    assert found["held_by"] == shown and found["sigmas"] == {"a": 1.0} and "chance" not in found
    assert found["extremes"] == {"alpha": [-0.1, 0.2]} and found["scale"] == 0.5


@pytest.mark.parametrize(
    ("band", "said"), [((0.1, 3.0), "does not follow a sweep to 3 Hz"), ((0.02, 1.0), "0.042 Hz")]
)
def test_a_pilot_flies_no_more_than_two_hertz_nor_two_minutes(
    band: tuple[float, float], said: str
) -> None:
    with pytest.raises(DeclarationError, match=said):
        _refuse_band(replace(ASKED, band=band))
    _refuse_band(replace(ASKED, band=band, computer=True))
    _refuse_band(replace(ASKED, band=(0.05, 2.0)))
    assert replace(ASKED, band=band, computer=True).command().endswith("--computer")
    assert "--computer" not in ASKED.command()


def test_the_slower_of_hand_and_actuator_limits_the_rate_unless_a_rate_is_named() -> None:
    model = rigid_model()
    for degrees, by_hand in ((3.0, 20.0), (12.0, 60.0)):
        limits = Limits({}, {"elevator": degrees * DEGREE}, {})
        assert with_usual_rates(limits, model, PILOT).rate == pytest.approx(
            {"elevator": by_hand * DEGREE}
        )
        assert with_usual_rates(limits, model, COMPUTER).rate == {"elevator": ACTUATOR_RATE}
    named = Limits({}, {"elevator": 0.05}, {"elevator": 9.0})
    assert with_usual_rates(named, model, PILOT).rate == {"elevator": 9.0}
    engine: Any = SimpleNamespace()
    thrust = Limits({}, {"thrust": 600.0}, {})
    assert with_usual_rates(thrust, engine, COMPUTER).rate == {"thrust": 600.0 / ENGINE_RISE}
    push = Limits({}, {"push": 1.0}, {})
    assert with_usual_rates(push, chain(-2.0), COMPUTER).rate == {}
    assert with_usual_rates(push, chain(-2.0), PILOT).rate == {"push": 1.0 / PILOT.rise}


def test_a_pilot_rests_between_steps_and_ends_a_long_sweep() -> None:
    time = np.arange(20001) * 0.01
    free, human = (
        ManeuverLimits(time, 0.3, 1),
        ManeuverLimits(time, 0.3, 1, longest_sweep=120.0, rest=1.0),
    )

    def pauses(room: ManeuverLimits) -> float:
        rows = steps_in_turn(room, 0.3, doublet, 2.0)
        assert rows is not None
        active = np.flatnonzero(rows[0])
        gaps = np.diff(active) * 0.01
        return float(np.min(gaps[gaps > 0.1]))

    assert pauses(free) == pytest.approx(0.6, abs=0.03)
    assert pauses(human) == pytest.approx(1.0, abs=0.03)
    long, short = sweeps(free, 0.3), sweeps(human, 0.3)
    assert long is not None and short is not None
    for rows, seconds in ((long, free.active), (short, 120.0)):
        moving = np.flatnonzero(np.abs(rows[0]) > 1e-9)
        assert 0.01 * (moving[-1] - moving[0]) == pytest.approx(seconds, abs=0.1)


def test_every_output_of_a_built_in_model_has_an_instrument() -> None:
    for name in ("rigid", "lateral", "longitudinal", "multirotor", "aircraft"):
        units = {signal.name for signal in base_for(name)[0].equations.outputs}
        assert units <= set(INSTRUMENTS), name
