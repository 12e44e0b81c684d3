"""Terms of coefficients: text, value, name and unit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.aerodynamics import FLOW, Factor, Term, TermTable, parse_term
from sim.errors import DeclarationError

SIGNALS = (*FLOW, "elevator", "rudder")
FACTORS = st.one_of(
    st.builds(Factor, st.sampled_from(SIGNALS), st.integers(1, 4)),
    st.builds(Factor, st.sampled_from(SIGNALS), absolute=st.just(True)),
    st.builds(
        Factor,
        st.sampled_from(SIGNALS),
        st.integers(0, 3),
        knot=st.sampled_from([-0.2, 0.0, 0.05, 0.3]),
    ),
)


@given(
    st.lists(FACTORS, max_size=3, unique_by=lambda each: (each.signal, each.absolute, each.knot))
)
def test_a_text_is_read_back_to_the_same_term(factors: list[Factor]) -> None:
    term = parse_term("*".join(each.text for each in factors) or "1", SIGNALS)
    assert parse_term(term.text, SIGNALS) == term
    assert set(term.factors) == set(factors)
    assert term.label.isidentifier() or term.label == "0" or not term.label[0].isdigit()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("alpha", 0.3),
        ("alpha^3", 0.027),
        ("elevator * alpha", -0.06),
        ("beta*abs(beta)", -0.01),
        ("spline(alpha, 0.2, 1)", 0.1),
        ("spline(alpha, 0.2, 2)*elevator", -0.002),
        ("spline(beta, 0.2, 1)", 0.0),
        ("spline(alpha, 0.2, 0)", 1.0),
    ],
)
def test_values(text: str, value: float) -> None:
    values = {"alpha": 0.3, "beta": -0.1, "elevator": -0.2}
    term = parse_term(text, SIGNALS)
    assert term.of(values) == pytest.approx(value, abs=1e-15)
    rows = {name: np.array([each, 0.0]) for name, each in values.items()}
    assert np.broadcast_to(term.of(rows), 2)[0] == pytest.approx(value, abs=1e-15)


@pytest.mark.parametrize("text", ["alpha^2", "beta*abs(beta)", "spline(alpha, 0.2, 2)*elevator"])
def test_slopes_by_complex_steps_are_those_of_differences(text: str) -> None:
    values = {"alpha": 0.3, "beta": -0.1, "elevator": -0.2}
    term = parse_term(text, SIGNALS)
    for name in term.signals:
        exact = term.of({**values, name: values[name] + 1e-30j}).imag / 1e-30
        up, down = (term.of({**values, name: values[name] + step}) for step in (1e-6, -1e-6))
        assert exact == pytest.approx((up - down) / 2e-6, rel=1e-8)


def test_a_product_has_one_name_and_a_unit_per_radian() -> None:
    one, other = (parse_term(text, SIGNALS) for text in ("elevator*alpha", "alpha * elevator"))
    assert one == other and one.label == "alpha_elevator"
    angles = {*SIGNALS} - {"mach"}
    assert one.unit(angles) == "1/rad2"
    assert parse_term("mach*q", SIGNALS).unit(angles) == "1/rad"
    assert Term().unit(angles) == "1" and Term().label == "0"
    assert parse_term("alpha*alpha", SIGNALS).text == "alpha^2"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("flap", "unknown signal flap"),
        ("alpha^", "is no term"),
        ("alpha^0", "is no term"),
        ("alpha*", "is no term"),
        ("spline(alpha)", "is no term"),
        ("abs(beta)*abs(beta)", "no product of powers"),
        ("__import__('os')", "is no term"),
    ],
)
def test_what_is_no_term_is_refused_in_one_line(text: str, told: str) -> None:
    with pytest.raises(DeclarationError, match=told) as caught:
        parse_term(text, SIGNALS, "vehicle x, key aerodynamics.Cm")
    assert "aerodynamics.Cm" in str(caught.value) and "\n" not in str(caught.value)


@given(st.lists(st.lists(FACTORS, max_size=3), max_size=6), st.booleans())
def test_a_table_of_terms_has_their_values_to_the_last_bit(
    products: list[list[Factor]], stepped: bool
) -> None:
    terms = [Term(tuple(factors)) for factors in products]
    rng = np.random.default_rng(3)
    signals = {name: rng.uniform(-0.5, 0.5, 4) + (1e-30j if stepped else 0.0) for name in SIGNALS}
    for term, value in zip(terms, TermTable(terms).values(signals), strict=True):
        assert np.array_equal(value, term.of(signals))


@pytest.mark.parametrize("value", [0.1 + 1e-30j, 0.1, np.array([0.1 + 1e-30j])])
def test_a_step_takes_complex_numbers_as_they_are(value: complex) -> None:
    assert Factor("alpha", 0, knot=0.05).of(value) == 1.0
    assert Factor("alpha", 0, knot=0.2).of(value) == 0.0
