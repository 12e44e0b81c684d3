"""Maneuvers in long records: simulated flights with known maneuvers, each kind by itself, what is
none, and speed.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.signal import lfilter

from ident.maneuver_detection import KINDS, FlightSignals, active_share, find_maneuvers
from sim.maneuvers import Maneuver, Sweep, doublet, orthogonal_multisines, pulse, three_two_one_one
from tests.long_flights import LongFlight, Score, fly, score

RATE = 50.0
NOISE = 1e-3  # rad, about a twentieth of the maneuvers


def scored(flights: list[LongFlight]) -> Score:
    total = Score(0, 0, 0, 0, 0)
    for number, flight in enumerate(flights):
        total += score(flight.known, find_maneuvers(flight.signals), f"{number}: ")
    return total


@pytest.mark.long
def test_two_flights() -> None:
    """Ten minutes each; the statistics are those of the slow test."""
    total = scored(fly([201, 204], length=600.0))
    assert total.known >= 12
    assert total.found >= 0.9 * total.known, total.missed
    assert total.false <= 2, total.invented


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(20), range(200, 220)], ids=["chosen on", "kept aside"])
def test_forty_flights(seeds: range) -> None:
    """Twenty flights on which the thresholds were chosen (with 100 to 119), and twenty that had no
    part in it.
    """
    total = scored(fly(seeds))
    assert total.known > 280
    assert total.found >= 0.95 * total.known, total.missed
    assert total.kinds >= 0.95 * total.found, total.confused
    assert total.false <= total.flights, total.invented


@pytest.mark.slow
def test_trim_points_are_quiet() -> None:
    """At most one in twenty of the trim points shares more than a second with a maneuver."""
    inside = total = 0
    for flight in fly(range(200, 210)):
        for one in find_maneuvers(flight.signals):
            if one.kind == "trim":
                total += 1
                shared = [min(k.end, one.end) - max(k.start, one.start) for k in flight.known]
                inside += max(shared) > 1.0
    assert total > 50
    assert inside <= 0.05 * total


def quiet(length: float, seed: int, noise: float = NOISE) -> tuple[np.ndarray, np.ndarray]:
    """Times, and a control at rest: a trim, slow wandering and white noise."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(length * RATE)) / RATE
    wander = lfilter([0.002], [1.0, -0.998], rng.standard_normal(times.size))
    return times, 0.03 + noise * (wander + rng.standard_normal(times.size))


AT = 61.0
FLOWN: dict[str, tuple[Maneuver, float]] = {
    "doublet": (doublet(0.02, 1.0, AT), 2.0),
    "3-2-1-1": (three_two_one_one(0.02, 0.8, AT), 5.6),
    "pulse": (pulse(-0.02, 1.2, AT), 1.2),
    "step": (pulse(0.02, 8.0, AT), 8.0),
    "sweep": (Sweep(0.02, 0.9, 12.0, 25.0, AT), 25.0),
    "multisine": (orthogonal_multisines([0.015], 20.0, 2, 30, AT)[0], 20.0),
}


@pytest.mark.parametrize(
    ("control", "axis"), [("elevator", "pitch"), ("rudder", "yaw"), ("stick", "pitch")]
)
@pytest.mark.parametrize("kind", FLOWN)
@pytest.mark.parametrize("scale", [1.0, -40.0])
def test_each_kind(kind: str, control: str, axis: str, scale: float) -> None:
    """Found with its kind, times, axis and amplitude, whatever the unit of the control and its
    sign.
    """
    times, rest = quiet(180.0, 3)
    maneuver, length = FLOWN[kind]
    values = scale * (rest + maneuver(times))
    (one,) = [
        each
        for each in find_maneuvers(FlightSignals(times, {control: values}, {}))
        if each.kind != "trim"
    ]
    assert (one.kind, one.axis, one.channel) == (kind, axis, control)
    assert one.start == pytest.approx(AT, abs=0.5)
    assert one.end == pytest.approx(AT + length, abs=0.8)
    assert one.amplitude == pytest.approx(
        0.02 * abs(scale), rel=0.15 if kind != "multisine" else 1.5
    )
    assert one.kind in KINDS


def test_noise_is_no_maneuver() -> None:
    """White noise, a slow trim and a pilot's Gaussian activity: nothing but trim points."""
    for seed in range(5):
        times, values = quiet(600.0, seed)
        busy = lfilter(
            [0.06], [1.0, -0.94], np.random.default_rng(seed + 50).standard_normal(times.size)
        )
        inputs = {"elevator": values, "aileron": values + 0.01 * busy}
        assert [
            each.kind
            for each in find_maneuvers(FlightSignals(times, inputs, {}))
            if each.kind != "trim"
        ] == []


def test_inputs_that_do_not_move() -> None:
    times = np.arange(3000) / RATE
    signals = FlightSignals(
        times, {"elevator": np.full(3000, 0.1)}, {"nz": np.ones(3000), "phi": np.zeros(3000)}
    )
    assert [each.kind for each in find_maneuvers(signals)] == ["trim"]
    assert active_share(signals) == 0.0


def test_multisines_together_and_a_control_that_follows() -> None:
    """Orthogonal multisines on three controls are three maneuvers; a rudder that follows the
    aileron is none.
    """
    times, _ = quiet(120.0, 0)
    lines = orthogonal_multisines([0.015, 0.015, 0.015], 20.0, 2, 40, 50.0)
    values = {
        name: quiet(120.0, seed)[1] + line(times)
        for seed, (name, line) in enumerate(
            zip(("elevator", "aileron", "rudder"), lines, strict=True)
        )
    }
    found = [
        each for each in find_maneuvers(FlightSignals(times, values, {})) if each.kind != "trim"
    ]
    assert sorted(each.axis for each in found) == ["pitch", "roll", "yaw"]
    follower = {**values, "rudder": quiet(120.0, 2)[1] + 0.15 * (values["aileron"] - 0.03)}
    found = [
        each for each in find_maneuvers(FlightSignals(times, follower, {})) if each.kind != "trim"
    ]
    assert sorted(each.axis for each in found) == ["pitch", "roll"]


def test_turn_and_pull_up() -> None:
    """A bank held for 30 s, and a smooth pull of a second each way with 0.6 g."""
    times, elevator = quiet(240.0, 5)
    bank = np.radians(35.0) * np.clip(np.minimum(times - 40.0, 80.0 - times) / 5.0, 0.0, 1.0)
    pull = np.clip(np.minimum(times - 150.0, 156.0 - times) / 1.5, 0.0, 1.0)
    rng = np.random.default_rng(1)
    outputs = {
        "phi": bank + 1e-3 * rng.standard_normal(times.size),
        "nz": 1.0 / np.cos(bank) + 0.6 * pull + 0.01 * rng.standard_normal(times.size),
        "airspeed": np.full(times.size, 80.0),
    }
    found = [
        each
        for each in find_maneuvers(
            FlightSignals(times, {"elevator": elevator - 0.05 * pull}, outputs)
        )
        if each.kind != "trim"
    ]
    assert [(each.kind, each.axis) for each in found] == [("turn", "roll"), ("pull-up", "pitch")]
    turn, up = found
    assert turn.amplitude == pytest.approx(np.radians(35.0), rel=0.02)
    assert [turn.start, turn.end] == pytest.approx([40.0, 80.0], abs=2.0)
    assert [up.start, up.end] == pytest.approx([150.0, 156.0], abs=1.0)
    assert turn.conditions == {"airspeed": pytest.approx(80.0)}


def test_pauses_uneven_rows_and_missing_samples() -> None:
    """A pause parts a record, and a jump of the trim across it is no step; jitter and missing
    samples do no harm.
    """
    times, values = quiet(200.0, 7)
    values = values + doublet(0.02, 1.0, 40.0)(times) + doublet(0.02, 1.0, 150.0)(times)
    values[times > 100.0] += 0.05
    kept = (times < 90.0) | (times > 110.0)
    rng = np.random.default_rng(2)
    q = np.where(rng.uniform(size=times.size) < 0.1, np.nan, 0.01 * rng.standard_normal(times.size))
    jitter = times + 0.2 / RATE * rng.uniform(-1.0, 1.0, times.size)
    found = [
        each
        for each in find_maneuvers(
            FlightSignals(jitter[kept], {"elevator": values[kept]}, {"q": q[kept]})
        )
        if each.kind != "trim"
    ]
    assert [each.kind for each in found] == ["doublet", "doublet"]
    assert [each.start for each in found] == [
        pytest.approx(40.0, abs=0.2),
        pytest.approx(150.0, abs=0.2),
    ]


def test_t_values_are_those_of_the_regression() -> None:
    """With white noise on the acceleration the t values are those that known derivatives and
    regressors give.
    """
    rng = np.random.default_rng(4)
    times = np.arange(4000) / RATE
    elevator = doublet(0.03, 1.5, 30.0)(times)
    alpha, q = np.zeros(times.size), np.zeros(times.size)
    derivatives = {"alpha": -6.0, "q": -2.0, "elevator": -8.0}
    for k in range(times.size - 1):
        moment = (
            derivatives["alpha"] * alpha[k]
            + derivatives["q"] * q[k]
            + derivatives["elevator"] * elevator[k]
        )
        q[k + 1] = q[k] + (moment + 0.3 * rng.standard_normal()) / RATE
        alpha[k + 1] = alpha[k] + (q[k] - 0.9 * alpha[k]) / RATE
    noisy = elevator + 1e-5 * rng.standard_normal(times.size)
    (one,) = [
        each
        for each in find_maneuvers(
            FlightSignals(times, {"elevator": noisy}, {"alpha": alpha, "q": q})
        )
        if each.kind != "trim"
    ]
    rows = slice(round((one.start - 1.0) * RATE), round((one.end + 4.0) * RATE))
    X = np.column_stack([alpha[rows], q[rows], elevator[rows], np.ones(rows.stop - rows.start)])
    sigma = 0.3 * np.sqrt(np.diag(np.linalg.inv(X.T @ X)))[:3]
    wanted = np.abs(list(derivatives.values())) / sigma
    assert list(one.excitation) == ["Cm_alpha", "Cm_q", "Cm_de"]
    # Averages of five samples and central differences: a third off, and the estimate scatters by
    # one.
    assert np.all(np.abs(np.array(list(one.excitation.values())) - wanted) < 0.35 * wanted + 2.0)


@pytest.mark.slow
def test_a_million_rows() -> None:
    """Under five seconds of computing for a million rows of five inputs and ten outputs."""
    flight = fly([0])[0].signals
    repeats = -(-1_000_000 // flight.time.size)
    tiled = {
        name: np.tile(values, repeats)[:1_000_000]
        for name, values in {**flight.inputs, **flight.outputs}.items()
    }
    inputs = {name: tiled.pop(name) for name in flight.inputs}
    inputs["stick"] = inputs["elevator"][::-1].copy()
    began = time.process_time()
    found = find_maneuvers(FlightSignals(np.arange(1_000_000) / RATE, inputs, tiled))
    assert time.process_time() - began < 5.0
    assert len(found) > 100


def test_a_short_record_without_noise() -> None:
    """Rest before the first level change takes one second, the whole record twenty, and the input
    is exact.
    """
    times = np.arange(1000) / RATE
    values = three_two_one_one(0.07, 0.5, 1.0)(times) - doublet(0.035, 1.0, 9.0)(times)
    found = find_maneuvers(FlightSignals(times, {"elevator": values}, {}))
    found = tuple(each for each in found if each.kind != "trim")
    assert [each.kind for each in found] == ["3-2-1-1", "doublet"]
    assert [each.start for each in found] == pytest.approx([1.0, 9.0], abs=0.1)
    assert [each.end for each in found] == pytest.approx([4.5, 11.0], abs=0.1)


def test_a_control_that_moves_much_more_leads() -> None:
    """A small aileron doublet during a rudder motion of no form that is far above its rest level is
    a reaction.
    """
    times, rudder = quiet(120.0, 8)
    rng = np.random.default_rng(9)
    inside = (times > 57.0) & (times < 66.0)
    motion = lfilter([0.1], [1.0, -0.9], rng.standard_normal(times.size))
    _, aileron = quiet(120.0, 10)
    aileron = aileron + doublet(0.008, 1.5, 60.0)(times)
    alone = find_maneuvers(FlightSignals(times, {"aileron": aileron, "rudder": rudder}, {}))
    assert [each.kind for each in alone if each.kind != "trim"] == ["doublet"]
    both = find_maneuvers(
        FlightSignals(times, {"aileron": aileron, "rudder": rudder + 0.15 * inside * motion}, {})
    )
    assert [each for each in both if each.axis == "roll"] == []


@pytest.mark.parametrize(("pause", "kinds"), [(0.6, ["doublet"]), (3.0, ["pulse", "pulse"])])
def test_a_doublet_may_pause_between_its_halves(pause: float, kinds: list[str]) -> None:
    """By no more than the shorter half lasts: two pulses that are further apart are two
    maneuvers.
    """
    times, rudder = quiet(120.0, 8)
    rudder = rudder + pulse(0.02, 1.2, 60.0)(times) - pulse(0.015, 0.9, 61.2 + pause)(times)
    found = [
        each
        for each in find_maneuvers(FlightSignals(times, {"rudder": rudder}, {}))
        if each.kind != "trim"
    ]
    assert [each.kind for each in found] == kinds
    assert [found[0].start, found[-1].end] == pytest.approx([60.0, 62.1 + pause], abs=0.2)


@pytest.mark.parametrize("control", ["thrust", "elevator"])
def test_a_ramp_is_no_trim_point(control: str) -> None:
    times, values = quiet(300.0, 5)
    values = values + 0.1 * np.clip((times - 100.0) / 60.0, 0.0, 1.0)
    found = find_maneuvers(FlightSignals(times, {control: values}, {}))
    assert all(each.end < 110.0 or each.start > 150.0 for each in found if each.kind == "trim")
    assert sum(each.end - each.start for each in found if each.kind == "trim") > 200.0


@pytest.mark.parametrize("control", ["thrust", "elevator"])
def test_a_step_that_is_not_taken_back(control: str) -> None:
    """A sharp change to another level that lasts is a step; the same change within twenty seconds
    is a new trim.
    """
    times, values = quiet(300.0, 11)
    sharp = values + 0.02 * (times > 100.0)
    (one,) = [
        each
        for each in find_maneuvers(FlightSignals(times, {control: sharp}, {}))
        if each.kind != "trim"
    ]
    assert (one.kind, one.channel) == ("step", control)
    assert [one.start, one.end] == pytest.approx([100.0, 110.0], abs=0.1)
    assert one.amplitude == pytest.approx(0.02, rel=0.1)
    slow = values + 0.02 * np.clip((times - 100.0) / 20.0, 0.0, 1.0)
    assert [
        each.kind
        for each in find_maneuvers(FlightSignals(times, {control: slow}, {}))
        if each.kind != "trim"
    ] == []
