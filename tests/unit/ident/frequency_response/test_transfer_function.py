"""Transfer functions fitted to responses: forms, cost, deviations, shared poles, envelopes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from ident.frequency_response.transfer_function import (
    FORMS,
    Form,
    ResponseTarget,
    coherence_weight,
    conditional_std,
    fit_transfer_functions,
    form_of,
    mismatch_cost,
    neighbour_correlation,
    unnoticeable_envelopes,
)
from sim.errors import ModelError

OMEGA = np.geomspace(0.3, 30.0, 60)
VALUES = {
    "pitch": {"gain": 5.0, "inv_T_theta2": 0.8, "frequency": 3.0, "damping": 0.6, "delay": 0.08},
    "roll": {"gain": -7.0, "inv_T_roll": 2.5, "delay": 0.05},
    "dutch-roll": {"gain": 3.0, "frequency": 2.0, "damping": 0.15, "delay": 0.0},
    "roll-and-dutch-roll": {
        "gain": 9.0,
        "numerator_frequency": 2.2,
        "numerator_damping": 0.2,
        "inv_T_roll": 4.0,
        "frequency": 1.8,
        "damping": 0.1,
        "delay": 0.03,
    },
    "1/2": {"b0": 4.0, "b1": 5.0, "a0": 9.0, "a1": 3.6, "delay": 0.1},
}


def written_out(name: str, s: np.ndarray) -> np.ndarray:
    """The forms a second time, as the standards print them."""
    p = VALUES[name]
    late = np.exp(-p["delay"] * s)
    if name == "1/2":
        return (p["b1"] * s + p["b0"]) / (s**2 + p["a1"] * s + p["a0"]) * late
    out = p["gain"] * late
    if "frequency" in p:
        out = out / (s**2 + 2 * p["damping"] * p["frequency"] * s + p["frequency"] ** 2)
    if "inv_T_roll" in p:
        out = out / (s + p["inv_T_roll"])
    if "inv_T_theta2" in p:
        out = out * (s + p["inv_T_theta2"])
    if "numerator_frequency" in p:
        w, z = p["numerator_frequency"], p["numerator_damping"]
        out = out * (s**2 + 2 * z * w * s + w**2)
    return np.asarray(out)


def target(response: np.ndarray, error: float = 0.02, name: str = "y/x") -> ResponseTarget:
    size = response.size
    return ResponseTarget(
        name, OMEGA, response, np.full(size, 0.95), error * np.abs(response), 40.0
    )


@pytest.mark.parametrize("name", list(VALUES))
def test_exact_responses_give_their_values(name: str) -> None:
    form = form_of(name)
    exact = written_out(name, 1j * OMEGA)
    np.testing.assert_allclose(form.response(VALUES[name], OMEGA), exact, rtol=1e-12)
    fit = fit_transfer_functions([target(exact)], [form])
    (one,) = fit.functions
    assert fit.converged and one.cost < 1e-6
    for key, value in VALUES[name].items():
        assert one.values[key] == pytest.approx(value, rel=1e-3, abs=1e-4), key
    ratio = np.polyval(one.numerator, 2j) / np.polyval(one.denominator, 2j)
    assert ratio * np.exp(-2j * one.values["delay"]) == pytest.approx(
        written_out(name, np.array(2j)), rel=1e-3
    )


@pytest.mark.long
def test_deviations_are_the_scatter_of_fits() -> None:
    """Errors that are drawn with the correlation of neighbours give the reported deviations."""
    form, exact = FORMS["pitch"], written_out("pitch", 1j * OMEGA)
    rng = np.random.default_rng(3)
    apart = np.subtract.outer(OMEGA, OMEGA) / (2.0 * math.pi) * 40.0
    root = np.linalg.cholesky(neighbour_correlation(apart) + 1e-9 * np.eye(OMEGA.size))
    values, reported = [], []
    for _ in range(120):
        noise = root @ (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1.0j]))
        (one,) = fit_transfer_functions([target(exact * (1.0 + 0.02 * noise))], [form]).functions
        values.append([one.values[name] for name in form.parameters])
        reported.append([one.std[name] for name in form.parameters])
    scatter, std = np.std(values, axis=0), np.median(reported, axis=0)
    np.testing.assert_allclose(std / scatter, 1.0, atol=0.2)


@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(["pitch", "roll", "dutch-roll"]),
    tilt=st.floats(-2.0, 2.0),
    length=st.floats(2.0, 200.0),
    seed=st.integers(0, 1000),
)
def test_no_parameter_is_known_worse_where_the_others_are_known(
    name: str, tilt: float, length: float, seed: int
) -> None:
    """The cost weights points by their coherence, whatever their errors: where these differ much
    from one frequency to another, a fit with the others held scatters more than the free one."""
    rng = np.random.default_rng(seed)
    std = 0.02 * (OMEGA / 3.0) ** tilt
    exact = written_out(name, 1j * OMEGA)
    response = exact * (1.0 + std * (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1j])))
    coherence = 1.0 / (1.0 + 40.0 * std**2)
    data = ResponseTarget("y/x", OMEGA, response, coherence, std * np.abs(response), length)
    (one,) = fit_transfer_functions([data], [FORMS[name]]).functions
    names = list(one.std)
    for at, key in enumerate(names):
        assert 0.0 < one.insensitivity[key] <= one.std[key], key
        # The variance left once the others are known, written out.
        rest = [n for n in range(len(names)) if n != at]
        c = one.covariance
        whole = c[np.ix_(rest, rest)]
        scale = np.sqrt(np.diag(whole))
        weights = np.linalg.solve(whole / np.outer(scale, scale), c[rest, at] / scale)
        left = c[at, at] - float(weights @ (c[rest, at] / scale))
        assert one.insensitivity[key] ** 2 == pytest.approx(left, rel=1e-4), key


def test_a_parameter_without_error_is_insensitive_to_nothing() -> None:
    alike = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    found = conditional_std(alike)
    assert found[2] == 0.0 and np.all(found <= np.sqrt(np.diag(alike)))


def test_what_is_fixed_stays_and_the_others_are_known_better() -> None:
    exact = written_out("pitch", 1j * OMEGA)
    (free,) = fit_transfer_functions([target(exact)], [FORMS["pitch"]]).functions
    (held,) = fit_transfer_functions(
        [target(exact)], [FORMS["pitch"]], {"inv_T_theta2": 0.8}
    ).functions
    assert held.values["inv_T_theta2"] == 0.8 and "inv_T_theta2" not in held.std
    assert held.std["frequency"] < free.std["frequency"]
    (wrong,) = fit_transfer_functions(
        [target(exact)], [FORMS["pitch"]], {"inv_T_theta2": 3.0}
    ).functions
    assert wrong.cost > 50.0 > held.cost


def test_shared_poles_are_one() -> None:
    one, other = written_out("pitch", 1j * OMEGA), 2.0 / ((1j * OMEGA) ** 2 + 3.6j * OMEGA + 9.0)
    rng = np.random.default_rng(4)
    noisy = [each * (1 + 0.05 * rng.standard_normal(OMEGA.size)) for each in (one, other)]
    targets = [
        target(each, 0.05, name) for each, name in zip(noisy, ("q/de", "alpha/de"), strict=True)
    ]
    forms = [FORMS["pitch"], FORMS["dutch-roll"]]
    fit = fit_transfer_functions(targets, forms, shared_poles=True)
    assert fit.shared == ("frequency", "damping")
    for name in fit.shared:
        values = {each.values[name] for each in fit.functions}
        assert len(values) == 1 and values.pop() == pytest.approx(VALUES["pitch"][name], rel=0.1)
    apart = fit_transfer_functions(targets, forms)
    assert apart.functions[0].values["frequency"] != apart.functions[1].values["frequency"]
    assert fit.functions[1].std["frequency"] < apart.functions[1].std["frequency"]


def test_cost_is_tischlers() -> None:
    """20/n sum W (gain^2 + 0.01745 phase^2): a dB and ten degrees everywhere, with coherence 1."""
    response = np.exp(-1j * OMEGA * 0.01)
    model = response * 10.0 ** (1.0 / 20.0) * np.exp(1j * math.radians(10.0))
    one = np.ones(OMEGA.size)
    weight = (1.58 * (1.0 - math.exp(-1.0))) ** 2
    assert mismatch_cost(response, model, one) == pytest.approx(20.0 * weight * (1.0 + 1.745))
    assert weight == pytest.approx(1.0, abs=0.003)  # the weight is 1 where the coherence is
    assert coherence_weight(np.array([0.0]))[0] == 0.0


def test_neighbours_correlate_as_squared_windows() -> None:
    size = 4096
    window = signal.get_window("hann", size) ** 2
    for bins in (0.0, 0.3, 1.0, 1.7, 2.5):
        turn = np.exp(-2j * math.pi * bins * np.arange(size) / size)
        expected = abs(np.sum(window * turn) / np.sum(window)) ** 2
        assert neighbour_correlation(np.array([bins]))[0] == pytest.approx(expected, abs=1e-6)


def test_envelopes_are_narrow_where_pilots_close_the_loop() -> None:
    """Two points of the published curves, with scipy; narrowest about the short period."""
    w, high, _ = signal.bode(([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]), [0.5, 5.0])
    _, low, _ = signal.bode(([0.0955, 9.92, 2.15], [1.0, 11.60, 4.95]), [0.5, 5.0])
    found = unnoticeable_envelopes(w)
    np.testing.assert_allclose(found.high_gain, high, rtol=1e-9)
    np.testing.assert_allclose(found.low_gain, low, rtol=1e-9)
    wide = unnoticeable_envelopes(np.geomspace(0.1, 10.0, 200))
    assert np.all(wide.low_gain < 0.0) and np.all(wide.high_gain > 0.0)
    assert np.all(wide.low_phase < 0.0) and np.all(wide.high_phase > 0.0)
    least = np.geomspace(0.1, 10.0, 200)[np.argmin(wide.high_gain - wide.low_gain)]
    assert 1.0 < least < 5.0


@pytest.mark.parametrize(
    ("forms", "fixed", "shared", "said"),
    [
        ([FORMS["roll"]], {"zeta": 1.0}, False, "no form has a parameter 'zeta'"),
        ([FORMS["roll"]], {"delay": math.nan}, False, "delay = nan"),
        ([FORMS["roll"]], {"delay": 0.0, "gain": 1.0, "inv_T_roll": 1.0}, False, "nothing is free"),
        ([FORMS["roll"], FORMS["pitch"]], {}, True, "different parameters"),
    ],
)
def test_refusals(forms: list[Form], fixed: dict[str, float], shared: bool, said: str) -> None:
    exact = written_out("roll", 1j * OMEGA)
    with pytest.raises(ModelError, match=said):
        fit_transfer_functions([target(exact)] * len(forms), forms, fixed, shared_poles=shared)


@pytest.mark.parametrize("text", ["", "1", "2/1", "1/0", "x/2", "1/2/3", "1/99", "phugoid"])
def test_what_is_no_form(text: str) -> None:
    with pytest.raises(ModelError):
        form_of(text)
