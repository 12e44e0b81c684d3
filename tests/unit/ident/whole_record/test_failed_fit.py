"""A fit that is none is called so; one that is poor is not."""

from __future__ import annotations

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.tracing.loop import diagnose
from ident.whole_record.output_error import failed_simulation, none_determined
from scenarios.identification.cautions import failed
from scenarios.studies.declaration import Row
from sim.declaration.model import Noise
from sim.errors import ModelError
from sim.record import Hold, Record
from sim.vehicles.factory import model_from_constants
from tests.oracles.held_fighter import CONSTANTS, DERIVATIVES, Held, fly_held

MOTION = np.sin(np.arange(400) * 0.1)
UNITS = {"q": "rad/s"}


@pytest.mark.parametrize(
    ("factor", "why"),
    [
        (0.01, ""),
        (0.8, ""),
        (1.5, "the fit is worse than constant outputs"),
        (50.0, "the free simulation diverges"),
        (1e30, "the free simulation"),
    ],
)
def test_a_residual_beyond_the_signal_is_no_fit(factor: float, why: str) -> None:
    """A constant level leaves the motion itself, so that no minimum leaves more."""
    said = failed_simulation(UNITS, [MOTION], [factor * MOTION])
    assert said.startswith(why) and bool(said) is bool(why)
    assert not why or "q error" in said


def test_one_channel_that_is_worse_than_a_level_may_be_the_price_of_another() -> None:
    both = {"q": "rad/s", "nz": "g"}
    assert failed_simulation(both, [MOTION, MOTION], [0.02 * MOTION, 1.5 * MOTION]) == ""
    assert "nz error" in failed_simulation(both, [MOTION, MOTION], [0.9 * MOTION, 1.5 * MOTION])


def test_sigmas_beyond_three_declared_sizes_of_all_derivatives_determine_nothing() -> None:
    assert none_determined([(2591.0, -0.9), (40.0, 5.0)])
    assert not none_determined([(2591.0, -0.9), (0.1, 5.0)])
    assert not none_determined([(2591.0, 0.0)]) and not none_determined([])
    assert none_determined([(float("nan"), 1.0)])


def unstable(duration: float, margin: float) -> list[Record]:
    derivatives = dict(DERIVATIVES, Cm_alpha=margin)
    rng = np.random.default_rng(5)
    flown = [
        fly_held(rng, Held(1.2, 0.6, kind, 0.05, duration), derivatives)
        for kind in ("doublets", "3211")
    ]
    outputs = ("q", "nz")
    return [
        Record(r.time, r.inputs, tuple(r[name] for name in outputs), Hold.LINEAR, name=f"{i}.csv")
        for i, r in enumerate(flown)
    ]


@pytest.mark.long
def test_a_diagnosis_of_an_aircraft_that_no_free_simulation_follows_ends_in_one_line() -> None:
    """Growth by e^60 along the record: q error 2e6 rad/s after the fit, with derivatives near the
    truth.
    """
    declared = {name: 0.8 * value for name, value in (DERIVATIVES | {"Cm_alpha": 0.6}).items()}
    model = (
        model_from_constants("rigid", CONSTANTS, declared)
        .with_noise(Noise())
        .with_biases(["q", "nz"])
    )
    with pytest.raises(ModelError) as caught:
        diagnose(unstable(30.0, 0.6), model, (), (), ())
    told = str(caught.value)
    assert told.startswith(
        "0.csv, 1.csv: the fit of the declared model has failed: the free simulation diverges "
        "from the record ("
    )
    assert (
        "identify --method filter-error or equation-error" in told
        and "single maneuvers of at most 5" in told
        and "\n" not in told
    )


@pytest.mark.long
def test_a_diagnosis_of_one_that_can_be_followed_goes_on() -> None:
    model = (
        model_from_constants("rigid", CONSTANTS, DERIVATIVES)
        .with_noise(Noise())
        .with_biases(["q", "nz"])
    )
    records = unstable(8.0, 0.15)
    centred = [
        Record(
            r.time,
            tuple(c.of(c.name, c.unit, c.values - c.values[0]) for c in r.inputs),
            r.outputs,
            r.hold,
            name=r.name,
        )
        for r in records
    ]
    found = diagnose(centred, model, (), (), ())
    assert found.after["Cm_alpha"].value == pytest.approx(0.15, abs=0.05)


def test_an_identification_says_so_with_the_same_words() -> None:
    (record,) = unstable(8.0, 0.15)[:1]
    z, _ = record.output_array(("q", "nz"))
    rows = (Row("Cm_alpha", "1", 0.15, 0.01), Row("Cm_q", "1", -5.0, 2591.0))

    def said(fitted: np.ndarray, some: tuple[Row, ...] = rows) -> tuple[str, ...]:
        two = np.zeros(2)
        estimate = Estimate(
            "output-error",
            ("Cm_alpha", "Cm_q"),
            ("1", "1"),
            two,
            np.eye(2),
            Outcome.CONVERGED,
            0.0,
            ("q", "nz"),
            two,
            (fitted,),
        )
        return failed([record], estimate, some, DERIVATIVES)

    assert said(z) == ()
    (away,) = said(1e6 * z)
    assert (
        away.startswith("the fit has failed: the free simulation diverges from the record (")
        and "--method filter-error" in away
    )
    (open_,) = said(z, rows[1:])
    assert open_.startswith("the fit has failed: the records determine none of the derivatives")
