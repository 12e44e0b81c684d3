"""Parameters that are curves of a signal, traced on flights by a second simulator; and none claimed
where there is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.loop import diagnose
from scenarios.diagnosis.opening import can_act, candidates_for
from sim.declaration import own_model
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.unmeasured_input import discrepancy_for
from sim.effects.library import catch_all_terms_for, effects_for
from sim.record import Record
from sim.vehicles.factory import model_from_constants
from tests.bases import RIGID_VALUES, rigid_model
from tests.oracles.varying_parameters import Law, Push, lateral, rigid, spring
from tests.own_models import spring_mass
from tests.whole_axes import CONSTANTS, TRUE


def spring_model(unit: float = 1.0) -> Model:
    """``unit`` : of stiffness and damping, in SI."""
    model = own_model(
        name="spring-mass",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "N"},
        outputs={"x": "m", "acceleration": "m/s2"},
        constants={"m": (2.0, "kg")},
        parameters={"k": (40.0 / unit, "N/m"), "c": (1.3 / unit, "N s/m")},
        flow=lambda s, p: {"a": (s.force - unit * (p.c * s.v + p.k * s.x)) / p.m},
        rates=lambda s, p: {"x": s.v, "v": s.a},
        readings=lambda s, p: {"x": s.x, "acceleration": s.a},
    )
    return model.with_biases(("x", "acceleration"))


def loaded_spring() -> Model:
    """The same with a port for forces, which the accelerometer feels."""
    return spring_mass(ports={"load": "N"}).with_biases(("x", "acceleration"))


def rigid_wrong() -> Model:
    """The aircraft with derivatives 20 % off."""
    values = {
        name: (0.8 * value if name.startswith(("CL", "Cm")) else value)
        for name, value in RIGID_VALUES.items()
    }
    return rigid_model(values).with_biases(("alpha", "q", "nz"))


def lateral_wrong() -> Model:
    derivatives = {name: 0.8 * value for name, value in TRUE["lateral"].items()}
    return model_from_constants("lateral", CONSTANTS["lateral"], derivatives).with_biases(
        ("beta", "p", "r", "phi", "ny")
    )


def diagnosed(
    model: Model, records: Sequence[Record], named: Sequence[Traceable] | None = None
) -> Diagnosis:
    """The last record held out; all candidates, or of the named effects a few and all instances of
    the general form.
    """
    candidates, guards = candidates_for(model), can_act(catch_all_terms_for(model.equations), model)
    few = (
        candidates
        if named is None
        else (*named, *(effect for effect in candidates if effect.traits.general))
    )
    return diagnose(
        records[:-1],
        model,
        few,
        guards,
        records[-1:],
        discrepancy=discrepancy_for(effects_for(model.equations)),
    )


def some(model: Model, *names: str) -> list[Traceable]:
    return [effect for effect in candidates_for(model) if effect.name in names]


def names(found: Diagnosis) -> list[str]:
    return [claim.name for claim in found.effects if claim.claimed]


def hardening(x: float) -> float:
    return 50.0 * (1.0 + x * x)


def stalling(alpha: float) -> float:
    """Damping that fades beyond an angle of attack of 0.04 rad."""
    return float(1.0 - 0.6 / (1.0 + np.exp(-(alpha - 0.04) / 0.015)))


@pytest.mark.long
@pytest.mark.parametrize("unit", [1.0, pytest.param(1e6, marks=pytest.mark.slow)])
def test_a_spring_that_hardens_is_a_stiffness_that_depends_on_displacement(unit: float) -> None:
    """In newtons as in meganewtons."""
    model = spring_model(unit)
    records = [spring(hardening, 1), spring(hardening, 2, 0.8)]
    found = diagnosed(
        model, records, some(model, "sensor-lag:x", "sensor-scale:acceleration", "input-delay")
    )
    assert found.verdict is Verdict.TRACED and names(found) == ["varies:k(x)"]
    assert abs(found.after["k"].value - 50.0 / unit) < 3.0 * found.after["k"].std
    seen = {candidate.name for candidate in found.candidates}
    assert {
        "varies:k(v)",
        "varies:c(x)",
        "varies:c(v)",
        "varies:k(force)",
        "varies:c(force)",
    } < seen, "what was looked at stays as evidence"


def test_on_a_clean_record_and_on_one_that_a_named_effect_explains_no_instance_is_looked_at() -> (
    None
):
    model = spring_model()
    clean = diagnosed(
        model,
        [spring(lambda x: 50.0, 3), spring(lambda x: 50.0, 4, 0.8)],
        some(model, "sensor-scale:acceleration"),
    )
    assert clean.verdict is Verdict.CONSISTENT and not clean.effects
    assert not any(
        candidate.name.startswith("varies:") and candidate.fitted for candidate in clean.candidates
    )


@pytest.mark.long
def test_what_no_record_tells_apart_is_told_with_its_alternative() -> None:
    """Damping that grows evenly with displacement is a stiffness that grows evenly with the speed:
    c1 x v either way, and both have a name.
    """
    model = spring_model()
    records = [
        spring(lambda x: 50.0, seed, size, lambda x: 1.0 + 2.0 * x)
        for seed, size in ((1, 1.0), (2, 0.8))
    ]
    found = diagnosed(model, records, some(model, "sensor-lag:x"))
    assert found.verdict in (Verdict.TRACED, Verdict.AMBIGUOUS) and len(names(found)) == 1, (
        "by priors alone"
    )
    assert {*names(found), *found.effects[0].alternatives} == {"varies:c(x)", "varies:k(v)"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("guard", "extra"),
    [
        ("guard:periodic-loads", lambda t, x, f: 3.0 * np.cos(7.0 * t)),
        ("guard:force-force", lambda t, x, f: 0.02 * f * f),
        pytest.param(
            "guard:lagged-loads:x", lambda t, x, f: -25.0 * (x[0] - x[2]), marks=pytest.mark.slow
        ),
    ],
)
def test_what_an_own_model_has_no_name_for_stays_without_one(guard: str, extra: Push) -> None:
    """A shaken base, a motor that pushes by the square of its command, a spring that relaxes: a
    guard wins, and no name is claimed.
    """
    model = loaded_spring()
    records = [
        spring(lambda x: 50.0, seed, size, extra=extra) for seed, size in ((1, 1.0), (2, 0.8))
    ]
    found = diagnosed(model, records)
    assert found.verdict is Verdict.UNEXPLAINED and not names(found)
    assert any(guard in caution.sentence for caution in found.warnings)


@pytest.mark.long
@pytest.mark.parametrize(
    "model", [loaded_spring(), pytest.param(spring_model(), marks=pytest.mark.slow)]
)
def test_a_spring_that_stiffens_in_flight(model: Model) -> None:
    """Its time and its change are found, and damping stays what it was."""
    records = [
        spring(lambda x: 50.0, seed, size, extra=lambda t, x, f: -15.0 * x[0] * (t > 8.3))
        for seed, size in ((1, 1.0), (2, 0.8))
    ]
    found = diagnosed(model, records)
    assert found.verdict is Verdict.TRACED and names(found) == ["derivative-jump"]
    told = found.effects[0].parameters
    assert (
        abs(told["k"].value - 15.0) < 4.0 * told["k"].std
        and abs(told["c"].value) < 4.0 * told["c"].std
    )
    assert told["time"].value == pytest.approx(8.3, abs=0.05)


@pytest.mark.slow
def test_a_product_of_two_signals_stays_without_a_name() -> None:
    """Cm_q that grows evenly with alpha is Cm_alpha that grows evenly with q: the guard stands for
    both.
    """
    model = rigid_wrong()
    found = diagnosed(
        model,
        [rigid(lambda alpha: 1.0 - 5.0 * alpha, 1), rigid(lambda alpha: 1.0 - 5.0 * alpha, 2, 0.8)],
        some(model, "sensor-lag:q"),
    )
    assert found.verdict is Verdict.UNEXPLAINED and not names(found)
    told = " ".join(caution.sentence for caution in found.warnings)
    assert "guard:alpha-q" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("derivative", "law"),
    [
        ("Cl_p", lambda beta: 1.0 - 60.0 * beta * beta),
        ("Cn_dr", lambda beta: float(1.0 - 0.5 * np.tanh(abs(beta) / 0.08) ** 2)),
    ],
)
def test_a_lateral_derivative_that_depends_on_sideslip(derivative: str, law: Law) -> None:
    found = diagnosed(
        lateral_wrong(), [lateral({derivative: law}, 1), lateral({derivative: law}, 2, 0.8)]
    )
    assert found.verdict is Verdict.TRACED and names(found) == [f"varies:{derivative}(beta)"]
    assert (
        abs(found.after[derivative].value - TRUE["lateral"][derivative])
        < 4.0 * found.after[derivative].std
    )
    assert found.effects[0].probability[found.effects[0].name] > 0.95


@pytest.mark.slow
def test_an_instance_that_is_a_named_curve_bears_its_name() -> None:
    """Cn_beta over beta: the yawing moment bends, which is what a yaw nonlinearity says. Its few
    shapes leave a little of it, so that a part may stay unexplained.
    """
    bent = {"Cn_beta": lambda beta: 1.0 - 25.0 * beta * beta}
    found = diagnosed(lateral_wrong(), [lateral(bent, 1), lateral(bent, 2, 0.8)])
    assert found.verdict in (Verdict.TRACED, Verdict.PARTIAL)
    assert names(found) == ["yaw-nonlinearity"]


@pytest.mark.slow
@pytest.mark.parametrize("records", [2, 3])
def test_damping_that_fades_with_the_angle_of_attack(records: int) -> None:
    flights = [
        rigid(stalling, seed, size)
        for seed, size in zip(range(1, 1 + records), (1.0, 0.8, 0.9), strict=False)
    ]
    found = diagnosed(rigid_wrong(), flights)
    assert found.verdict is Verdict.TRACED and names(found) == ["varies:Cm_q(alpha)"]


@pytest.mark.slow
def test_beside_a_late_sensor() -> None:
    """A named effect and an instance at once: both are told."""
    late = [_late(spring(hardening, seed, size), 2) for seed, size in ((1, 1.0), (2, 0.8))]
    found = diagnosed(spring_model(), late)
    assert found.verdict in (Verdict.TRACED, Verdict.AMBIGUOUS)
    assert "varies:k(x)" in names(found) and any(
        name.startswith("sensor-") and name.endswith(":x") for name in names(found)
    )


def _late(record: Record, samples: int) -> Record:
    """The record with displacement read some samples late."""
    x = record["x"].values
    outputs = tuple(
        type(c).of(c.name, c.unit, np.concatenate([x[:1].repeat(samples), x[:-samples]]))
        if c.name == "x"
        else c
        for c in record.outputs
    )
    return Record(record.time, record.inputs, outputs, record.hold, record.name)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_clean_records_claim_nothing(seed: int) -> None:
    found = diagnosed(
        lateral_wrong(), [lateral({}, 100 + 2 * seed), lateral({}, 101 + 2 * seed, 0.8)]
    )
    assert found.verdict is Verdict.CONSISTENT and not found.effects
    straight = [rigid(lambda alpha: 1.0, 100 + 2 * seed + k, 1.0 - 0.2 * k) for k in (0, 1)]
    assert diagnosed(rigid_wrong(), straight).verdict is Verdict.CONSISTENT
    even = [spring(lambda x: 50.0, 100 + 2 * seed + k, 1.0 - 0.2 * k) for k in (0, 1)]
    assert diagnosed(spring_model(), even).verdict is Verdict.CONSISTENT
