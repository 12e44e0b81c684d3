"""Terms of coefficients found in flights whose terms are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from ident.structure.averaging import collinearity_of, multiples_of
from ident.structure.coefficients import (
    Airframe,
    Histories,
    bandwidth_of,
    filled,
    half_width,
    histories_of,
    noise_of,
)
from ident.structure.products import TermColumns, columns_of, products_of
from ident.structure.selection import (
    ORTHOGONAL,
    STEPWISE,
    orthogonal,
    select,
    stepwise,
)
from sim.aerodynamics import Term, parse_term
from sim.declaration.compile import compile_model
from sim.errors import RecordError
from sim.record import Hold
from sim.vehicles.aircraft import Aircraft, aircraft_model
from tests.airliner import AIRLINER, ELEVATOR, THRUST
from tests.bases import Flight, fly

RATE = 50.0
NOISE = {
    "airspeed": 0.05,
    "alpha": 2e-4,
    "beta": 2e-4,
    **dict.fromkeys("pqr", 2e-4),
    **dict.fromkeys(("ax", "ay", "az"), 0.01),
}
NAMES = ("alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder")
OFFERED = (
    *("1", "alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder"),
    *("alpha^2", "alpha*elevator", "alpha*beta", "alpha*p", "beta^2", "alpha^3", "q^2"),
    *("alpha*rudder", "alpha*aileron", "spline(alpha, 0.06, 1)"),
)


def term(text: str) -> Term:
    return parse_term(text, NAMES)


CURVED: Aircraft = replace(
    AIRLINER,
    coefficients={
        **AIRLINER.coefficients,
        "Cm": {**AIRLINER.coefficients["Cm"], term("alpha*elevator"): 4.0},
        "Cl": {**AIRLINER.coefficients["Cl"], term("alpha*beta"): -0.9},
    },
)


def wave(time: np.ndarray, size: float, seed: int) -> np.ndarray:
    """A multisine between 0.1 and 1 Hz."""
    rng = np.random.default_rng(seed)
    f = np.arange(0.1, 1.05, 0.1)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(f))
    return size * np.sum(np.sin(2 * np.pi * np.outer(time, f) + phases), axis=1) / np.sqrt(len(f))


@cache
def clean(seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Times, inputs and outputs without noise."""
    time = np.arange(int(12.0 * RATE) + 1) / RATE
    sizes = (0.05, 0.06, 0.05)
    u = np.array([wave(time, size, 3 * seed + i) for i, size in enumerate(sizes)])
    u[0] += ELEVATOR
    u = np.vstack([u, np.full(len(time), THRUST)])
    system = compile_model(aircraft_model(CURVED))
    rows = dict(zip(system.output_names, fly(system, Flight(time, u, max_step=0.02)), strict=True))
    return time, u, rows


@cache
def flown(seed: int, noise: float = 1.0) -> Histories:
    time, u, rows = clean(seed)
    rng = np.random.default_rng(100 + seed)
    channels = {
        name: rows[name] + noise * std * rng.standard_normal(len(time))
        for name, std in NOISE.items()
    }
    surfaces = dict(zip(CURVED.surfaces, u[:3], strict=True))
    airframe = Airframe(CURVED.constants, CURVED.sensors, wind_axes=True)
    return histories_of(f"maneuver {seed}", time, channels, airframe, surfaces, u[3], held=True)


def model_of(history: Histories, axis: str) -> np.ndarray:
    """The true coefficient, averaged over the windows."""
    table = CURVED.coefficients[axis]
    return columns_of(history, tuple(table), axis) @ np.array(list(table.values()))


@pytest.mark.long
@pytest.mark.parametrize("axis", ["CD", "CY", "CL", "Cl", "Cm", "Cn"])
def test_coefficients_are_those_of_the_aircraft(axis: str) -> None:
    history = flown(1, 0.0)
    true = model_of(history, axis)
    error = history.coefficients[axis] - true
    assert np.std(error) < (0.03 if axis == "CD" else 0.005) * np.std(true)


@pytest.mark.parametrize("hold", [Hold.PREVIOUS, Hold.LINEAR])
def test_values_do_not_hang_on_the_time_between_samples(hold: Hold) -> None:
    """Without noise values are right to a tenth of a per cent at 25 samples a second; with straight
    lines between samples of a curved motion they are off by four times that.
    """
    time = np.arange(301) / 25.0
    u = np.array([wave(time, size, 40 + i) for i, size in enumerate((0.05, 0.06, 0.05))])
    u = np.vstack([u + np.array([[ELEVATOR], [0.0], [0.0]]), np.full(len(time), THRUST)])
    system = compile_model(aircraft_model(CURVED))
    motion = fly(system, Flight(time, u, hold=hold, max_step=0.02))
    channels = dict(zip(system.output_names, motion, strict=True))
    airframe = Airframe(CURVED.constants, CURVED.sensors, wind_axes=True)
    surfaces = dict(zip(CURVED.surfaces, u[:3], strict=True))
    held = hold is Hold.PREVIOUS
    history = histories_of("m", time, channels, airframe, surfaces, u[3], held=held)
    for axis in ("Cl", "Cm", "Cn", "CY", "CL"):
        table = CURVED.coefficients[axis]
        found = select([history], axis, (Term(), *(each for each in table if each.factors)))
        for each, value in table.items():
            # Lift by pitch rate is read from a force that hardly knows it.
            if (axis, each.text) != ("CL", "q"):
                assert found.table[each] == pytest.approx(value, rel=1e-3), (axis, each.text)


@pytest.mark.long
def test_the_noise_is_what_the_sensors_give() -> None:
    clean, noisy = flown(2, 0.0), flown(2)
    for axis in ("CY", "Cl", "Cm", "Cn", "CL"):
        made = np.std(noisy.coefficients[axis] - clean.coefficients[axis])
        assert made == pytest.approx(float(np.mean(noisy.sigma[axis])), rel=0.35)


@pytest.mark.long
@pytest.mark.parametrize("method", [STEPWISE, ORTHOGONAL])
@pytest.mark.parametrize("axis", ["Cm", "Cl"])
def test_the_true_terms_are_found(method: str, axis: str) -> None:
    histories = [flown(seed) for seed in (1, 2, 3)]
    found = select(histories, axis, [term(text) for text in OFFERED], method)
    large = {
        term_
        for term_, value in CURVED.coefficients[axis].items()
        if term_.factors and abs(value) > 0.03
    }
    assert large <= set(found.terms)
    assert found.held_out > 0.97
    assert found.steps[-1].held_out == pytest.approx(found.held_out)
    values = found.table
    sigma = dict(zip(found.terms, found.sigma, strict=True))
    for term_ in large:
        assert abs(values[term_] - CURVED.coefficients[axis][term_]) < max(
            5.0 * sigma[term_], 0.08 * abs(CURVED.coefficients[axis][term_])
        )


def test_a_withheld_term_is_named() -> None:
    histories = [flown(seed, 0.1) for seed in (1, 2, 3)]
    lacking = term("alpha*elevator")
    offered = [term(text) for text in OFFERED if text not in ("alpha*elevator", "alpha^3")]
    found = select(histories, "Cm", offered, further=[lacking, term("q^3"), term("beta*p")])
    assert found.ratio > 1.3
    assert found.lacking[0][0] == lacking
    assert not select(histories, "CY", offered, further=[lacking]).lacking


def test_stepwise_is_least_squares_on_its_terms() -> None:
    rng = np.random.default_rng(3)
    X = np.hstack([np.ones((400, 1)), rng.standard_normal((400, 4))])
    z = X @ [1.0, 2.0, 0.0, -0.5, 0.0] + 0.1 * rng.standard_normal(400)
    terms = [term(text) for text in ("1", "alpha", "beta", "p", "q")]
    halves = [slice(0, 200), slice(200, 400)]
    products = products_of([X[h] for h in halves], [z[h] for h in halves], terms)
    chosen, steps = stepwise(products)
    assert sorted(chosen) == [0, 1, 3]
    part = X[:, chosen]
    left = z - part @ np.linalg.lstsq(part, z, rcond=None)[0]
    assert steps[-1].r2 == pytest.approx(1.0 - left @ left / np.sum((z - z.mean()) ** 2))
    predicted = np.empty(400)
    for own, other in (halves, halves[::-1]):
        predicted[own] = part[own] @ np.linalg.lstsq(part[other], z[other], rcond=None)[0]
    error = z - predicted
    assert steps[-1].held_out == pytest.approx(1.0 - error @ error / np.sum((z - z.mean()) ** 2))


def test_a_term_that_entered_for_others_is_exchanged() -> None:
    """A column that is nearly a true one, with a little of another, enters first. The true one adds
    too little beside it, and explains clearly more in its place.
    """
    rng = np.random.default_rng(5)
    X = rng.standard_normal((600, 4))
    X[:, 0] = 1.0
    X[:, 3] = X[:, 1] + 0.1 * X[:, 2] + 0.015 * rng.standard_normal(600)
    z = X @ [0.5, 1.0, 1.0, 0.0] + 0.002 * rng.standard_normal(600)
    terms = [term(text) for text in ("1", "alpha", "beta", "p")]
    chosen, steps = stepwise(products_of([X], [z], terms))
    told = [(step.term.text, step.added) for step in steps]
    assert told == [("p", True), ("beta", True), ("alpha", True), ("p", False)]
    # Of all pairs it is the one of least squares.
    best = min(
        combinations(range(1, 4), 2),
        key=lambda at: float(np.linalg.lstsq(X[:, [0, *at]], z, rcond=None)[1][0]),
    )
    assert set(best) == set(chosen) - {0}


@pytest.mark.parametrize("truth", ["beta", "beta*mach"])
@pytest.mark.parametrize("moved", [0.01, 0.2])
def test_the_simpler_of_two_terms_that_explain_the_same_is_chosen(truth: str, moved: float) -> None:
    """Where mach moves by a hundredth the product is beta itself, times a number; where it moves,
    the data decide.
    """
    rng = np.random.default_rng(11)
    names = (*NAMES, "mach")
    terms = [parse_term(text, names) for text in ("1", "p", "beta*mach", "beta")]
    mach = 0.4 * (1.0 + moved * rng.uniform(-1.0, 1.0, 500))
    signals = {"beta": rng.standard_normal(500), "p": rng.standard_normal(500), "mach": mach}
    X = np.stack([np.broadcast_to(each.of(signals), 500) for each in terms], axis=1)
    z = X[:, 1] + X[:, 2 if truth == "beta*mach" else 3] + 0.1 * rng.standard_normal(500)
    chosen, _ = stepwise(products_of([X], [z], terms))
    expected = 2 if truth == "beta*mach" and moved > 0.1 else 3
    assert sorted(chosen) == [0, 1, expected]


def test_of_terms_that_are_multiples_the_one_offered_first_enters() -> None:
    # An elevator that stands still makes elevator*rudder a multiple of rudder, up to rounding.
    rng = np.random.default_rng(8)
    terms = [term("1"), term("beta"), term("rudder"), term("elevator*rudder")]
    for still in rng.uniform(0.01, 0.3, 30):
        beta, rudder = rng.standard_normal((2, 200))
        X = np.stack([np.ones(200), beta, rudder, still * rudder], axis=1)
        z = 0.5 * beta - rudder + 0.1 * rng.standard_normal(200)
        for method in (stepwise, orthogonal):
            chosen, _ = method(products_of([X], [z], terms))
            assert 2 in chosen and 3 not in chosen


@pytest.mark.parametrize("curved", ["p*abs(p)", "alpha*p", "p^3"])
def test_a_product_enters_after_the_linear_terms_of_its_symmetry(curved: str) -> None:
    # A rate of one size alone makes p*abs(p) as good as p, and noise decides between them.
    rng = np.random.default_rng(5)
    rate = np.repeat([0.1, -0.1, 0.1, 0.0], 50) + 0.002 * rng.standard_normal(200)
    product = {"p*abs(p)": rate * abs(rate), "alpha*p": 0.1 * rate, "p^3": rate**3}[curved]
    X = np.stack([np.ones(200), product, rate], axis=1)
    terms = [term("1"), term(curved), term("p")]
    z = product / np.std(product) + 0.1 * rng.standard_normal(200)
    products = products_of([X], [z], terms)
    free, _ = stepwise(products)
    # alpha*p is a multiple of p here, and p is made of fewer signals.
    assert free[1] == (2 if curved == "alpha*p" else 1)
    chosen, _ = stepwise(products, hierarchical=True)
    assert chosen[1] == 2
    # Where the product is the truth, it enters second, and its parent stays.
    z = 5.0 * product / np.std(product) + 1e-3 * rng.standard_normal(200)
    chosen, _ = stepwise(products_of([X], [z], terms), hierarchical=True)
    if curved != "alpha*p":
        assert chosen[1:] == [2, 1]


def coloured(seed: int, memory: float) -> tuple[Histories, np.ndarray]:
    """Side force that is linear in beta and p, with gusts that last; columns of ``OF_SIDES``."""
    rng = np.random.default_rng(seed)
    time = 0.16 * np.arange(190)
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    beta = np.exp(-0.05 * time) * np.sin(1.2 * time + phases[0])
    p = np.exp(-0.1 * time) * np.sin(1.9 * time + phases[1])
    gust = np.zeros(len(time))
    keep = np.exp(-0.16 / memory)
    for k in range(1, len(time)):
        gust[k] = keep * gust[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    columns = [np.ones(len(time)), beta, p, beta * abs(beta), p * abs(p), beta**3, p**3]
    measured = {"CY": beta - 0.5 * p + 0.2 * gust}
    sigma = {"CY": np.full(len(time), 0.2)}
    rows = np.arange(len(time))
    flight = Histories(f"{seed}", time, {}, {}, measured, sigma, np.ones(1), rows, 3.0)
    return flight, np.stack(columns, axis=1)


def given(terms: Sequence[Term], blocks: Sequence[np.ndarray]) -> TermColumns:
    """TermColumns without noise of their signals."""
    return TermColumns(tuple(terms), blocks, [np.zeros((0, *block.shape)) for block in blocks])


OF_SIDES = ("1", "beta", "p", "beta*abs(beta)", "p*abs(p)", "beta^3", "p^3")


def test_gusts_bring_no_terms_in() -> None:
    terms = [term(text) for text in OF_SIDES]
    right = {terms[1], terms[2]}
    hits = wrong = searched = count = 0
    for seed in range(60):
        histories, blocks = zip(*(coloured(60 * i + seed, 0.8) for i in range(2)), strict=True)
        found = select(histories, "CY", terms, columns=given(terms, blocks), hierarchical=True)
        wrong += not right.issuperset(found.terms[1:])
        products = products_of(blocks, [h.coefficients["CY"] for h in histories], terms)
        searched += not right.issuperset(terms[i] for i in stepwise(products)[0][1:])
        if right == {*found.terms[1:]}:
            sigma = dict(zip(found.terms, found.sigma, strict=True))
            for each, value in ((terms[1], 1.0), (terms[2], -0.5)):
                hits += abs(found.table[each] - value) < 2.0 * sigma[each]
                count += 1
    assert wrong <= 1 < 3 < searched
    # 2-sigma intervals of the terms that were chosen: five sigmas below 95 % at the least.
    assert count > 100
    assert hits / count > 0.9545 - 5.0 * np.sqrt(0.9545 * 0.0455 / count)


def test_sigmas_count_residuals_that_are_larger_where_a_term_is() -> None:
    """Noise that grows with the term itself: the slope scatters sqrt(3) times as far as under noise
    of the same mean power everywhere.
    """
    terms, inside, sigmas, slopes = [term("1"), term("alpha")], [], [], []
    rows, time = np.arange(800), 0.1 * np.arange(800)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        x = rng.standard_normal(800)
        z = {"CD": 0.5 + x + 0.3 * x * rng.standard_normal(800)}
        sigma = {"CD": np.full(800, 0.3)}
        history = Histories("m", time, {}, {}, z, sigma, np.ones(1), rows, 3.0)
        block = np.stack([np.ones(800), x], axis=1)
        found = select([history], "CD", terms, columns=given(terms, [block]))
        slopes.append(found.values[1])
        sigmas.append(found.sigma[1])
        inside.append(abs(found.values[1] - 1.0) < 2.0 * found.sigma[1])
    # Var of the slope: sum x^4 0.09 / (sum x^2)^2 = 3 * 0.09 / 800.
    assert np.std(slopes) == pytest.approx(np.sqrt(0.27 / 800), rel=0.15)
    assert np.mean(sigmas) == pytest.approx(np.sqrt(0.27 / 800), rel=0.1)
    assert 0.90 < np.mean(inside) < 0.99


def test_collinear_surfaces_are_told_with_the_maneuver() -> None:
    rng = np.random.default_rng(1)
    one = rng.standard_normal(500)
    columns = np.stack([np.ones(500), one, 2.0 * one + 0.05 * rng.standard_normal(500)], axis=1)
    terms = [term("1"), term("aileron"), term("rudder")]
    found = collinearity_of("Cl", terms, columns, ("aileron", "rudder"))
    assert found.inflation.min() > 100.0
    assert found.correlations[0][2] > 0.99
    assert found.indices[0] > 30.0
    assert "one after the other" in found.advice[0]
    apart = collinearity_of("Cl", terms, rng.standard_normal((500, 3)), ("aileron", "rudder"))
    assert not apart.advice
    assert apart.inflation.max() < 1.1


@pytest.mark.parametrize(("moves", "alike"), [(0.1, True), (1.0, False)])
def test_a_product_with_a_signal_that_stays_is_the_multiple_of_its_term(
    moves: float, alike: bool
) -> None:
    rng = np.random.default_rng(2)
    beta, alpha = rng.standard_normal((2, 4000))
    alpha = 1.0 + moves * alpha
    terms = [term(text) for text in ("1", "beta", "alpha*beta", "beta^2", "alpha^2")]
    columns = np.stack([np.ones(4000), beta, alpha * beta, beta**2, alpha**2], axis=1)
    # beta and alpha*beta correlate by 1 / sqrt(1 + moves^2), with independent signals.
    assert (1.0 / (1.0 + moves**2) > 0.9) is alike
    expected = ((terms[1], terms[2]),) if alike else ()
    assert multiples_of(terms, columns, terms[:2]) == expected
    assert multiples_of(terms, columns, terms[:3]) == ()


def test_the_bandwidth_is_that_of_a_slope_of_sines() -> None:
    rate, half = 100.0, half_width(100.0, 2.0)
    n = np.arange(-half, half + 1)
    f = bandwidth_of(half, rate)
    assert f == pytest.approx(2.0, rel=0.15)
    wave_ = np.sin(2 * np.pi * f * n / rate)
    slope = float(n @ wave_ / (n @ n)) * rate
    assert slope / (2 * np.pi * f) == pytest.approx(np.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize("rate", [10.0, 50.0, 333.0])
@pytest.mark.parametrize("bandwidth", [0.5, 1.0, 3.0, 7.0, 200.0])
def test_the_widest_window_with_a_bandwidth_is_found(rate: float, bandwidth: float) -> None:
    half = half_width(rate, bandwidth)
    assert half == 1 or bandwidth_of(half, rate) >= bandwidth
    assert bandwidth_of(half + 1, rate) < bandwidth


def test_a_bandwidth_that_no_record_has_is_refused_at_once() -> None:
    time = np.arange(500) / 25.0
    channels = dict.fromkeys(NOISE, time)
    with pytest.raises(RecordError, match="500 samples are too few for slopes"):
        histories_of("m", time, channels, Airframe({}), {}, bandwidth=1e-4)


def test_noise_is_found_below_a_motion() -> None:
    rng = np.random.default_rng(5)
    time = np.arange(3000) / 50.0
    values = np.sin(2 * np.pi * 0.5 * time) + 0.02 * rng.standard_normal(3000)
    assert noise_of(values) == pytest.approx(0.02, rel=0.1)


def test_what_is_not_there_is_one_line() -> None:
    time = np.arange(20) / 50.0
    with pytest.raises(RecordError, match="it has no beta"):
        histories_of("short", time, {"airspeed": time, "alpha": time}, Airframe({}), {})
    with pytest.raises(RecordError, match="more than half of q"):
        filled(time, time > 0.3, "q", "short")
