"""The scenario `stall` and its relatives: flow separation is named where it acts, and nothing else
is called by its name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from scenarios.studies.catalogue import load_document
from scenarios.trials.planted_declaration import Grade
from scenarios.trials.planted_flights import trace_scenario_of
from scenarios.trials.planted_study import TraceStudy, run_trace

NAME = "flow-separation"
ON_RIGID = {"tau1": 0.3, "tau2": 0.08, "a1": 22.0, "alpha_star": 0.12, "moment": -0.06}
CURVE = {"shape1": 0.02, "shape2": 0.008, "shape3": 0.004, "shape4": 0.002}


def of_stall(seed: int, hidden: Mapping[str, Any] | None, pull: float = 1.0) -> TraceStudy:
    """The flights of `stall` with something else hidden, or nothing, and with another share of the
    elevator's steps.
    """
    document, _, where = load_document("stall")
    for part in ("train", "validate"):
        for maneuver in document["flight"][part]["maneuvers"]:
            if maneuver["input"] == "elevator" and maneuver["kind"] == "step":
                maneuver["amplitude"] = f"{pull * float(maneuver['amplitude'].split()[0])} deg"
    return run_trace(trace_scenario_of(changed(document, hidden), "stall", where), seed)


def of_rigid(seed: int, hidden: Mapping[str, Any] | None) -> TraceStudy:
    """The bomber pulled up to 0.2 rad above its trim."""
    document, _, where = load_document("trace-elastic")
    document["flight"].pop("modes")
    document["flight"]["vehicle"] = "bomber_rigid"
    for part in ("train", "validate"):
        for maneuver in document["flight"][part]["maneuvers"]:
            maneuver["amplitude"] = f"{-1.5 * float(maneuver['amplitude'].split()[0])} deg"
    return run_trace(trace_scenario_of(changed(document, hidden), "pull", where), seed)


def changed(document: dict[str, Any], hidden: Mapping[str, Any] | None) -> dict[str, Any]:
    document["hidden"] = [dict(hidden)] if hidden else []
    document["distance"] = "effect missing" if hidden else "nothing missing"
    document["expect"] = (
        {"verdicts": ["traced"], "effects": [[hidden["name"]]]}
        if hidden
        else {"verdicts": ["consistent"]}
    )
    return document


def claimed(study: TraceStudy) -> list[str]:
    return [claim.name for claim in study.tracing.diagnosis.effects if claim.claimed]


@pytest.mark.slow
def test_the_scenario_is_traced_with_its_derivatives_and_its_times() -> None:
    document, short, where = load_document("stall")
    study = run_trace(trace_scenario_of(document, short, where))
    assert study.grade is Grade.RIGHT
    assert len(study.derivatives) == 10 and {row.name for row in study.effects} == {
        f"{NAME}.{name}" for name in (*ON_RIGID, "drag")
    }
    for row in (*study.derivatives, *study.effects):
        assert abs(row.sigmas) < 3.5, row
    told = {row.name: row.after for row in study.effects}
    assert told[f"{NAME}.tau1"].std < 0.05 and told[f"{NAME}.alpha_star"].std < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_traced_on_a_rigid_aircraft(seed: int) -> None:
    study = of_rigid(seed, {"name": NAME, "values": ON_RIGID})
    assert study.grade is Grade.RIGHT
    assert all(abs(row.sigmas) < 3.5 for row in study.effects)


@pytest.mark.slow
def test_a_slow_approach_without_separation_claims_nothing() -> None:
    """At full pull the linear aircraft goes to the same angles, at half it stays below."""
    for pull in (1.0, 0.5):
        study = of_stall(1, None, pull)
        assert study.tracing.diagnosis.verdict.value == "consistent" and not claimed(study)


@pytest.mark.slow
@pytest.mark.parametrize("curve", ["moment-nonlinearity", "lift-nonlinearity"])
def test_a_static_curve_is_not_called_separation(curve: str) -> None:
    sign = -4.0 if curve.startswith("lift") else 1.0
    study = of_rigid(
        1, {"name": curve, "values": {name: sign * value for name, value in CURVE.items()}}
    )
    assert claimed(study) == [curve]


@pytest.mark.slow
def test_a_bent_moment_of_the_whole_axis_is_not_called_separation() -> None:
    study = of_stall(
        1,
        {
            "name": "moment-nonlinearity",
            "values": {name: -0.5 * value for name, value in CURVE.items()},
        },
    )
    assert claimed(study) == ["moment-nonlinearity"]
