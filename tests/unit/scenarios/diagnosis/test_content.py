"""diagnosis.json: what other programs read is there for every verdict, and every number is one."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from ident.tracing.diagnosis import Quantity, Verdict
from scenarios.diagnosis.text import LARGEST, diagnosis_content
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import VehicleFile
from scenarios.files.writing import json_text
from tests.diagnoses import BALLISTIC, LOES, RIGID, tracing_of

STUDIES = [
    pytest.param(
        verdict, vehicle, channels, id=f"{verdict.value}-{vehicle.model}-{'+'.join(channels)}"
    )
    for verdict in Verdict
    for vehicle, channels in (
        (RIGID, ("alpha", "q", "nz")),
        (RIGID, ("alpha", "q")),
        (LOES, ("alpha", "q", "nz")),
        (BALLISTIC, ("altitude",)),
    )
]


def strict(content: dict[str, Any]) -> dict[str, Any]:
    """What a strict reader makes of the text that is written."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    read: dict[str, Any] = json.loads(json_text(content), parse_constant=refuse)
    return read


def numbers(value: Any, path: str = "") -> list[tuple[str, float]]:
    """Every number of a document with the path to it."""
    if isinstance(value, dict):
        return [item for key, inner in value.items() for item in numbers(inner, f"{path}.{key}")]
    if isinstance(value, list):
        return [item for inner in value for item in numbers(inner, f"{path}[]")]
    return [(path, value)] if isinstance(value, int | float) and not isinstance(value, bool) else []


@pytest.mark.sampled
@pytest.mark.parametrize(("verdict", "vehicle", "channels"), STUDIES)
def test_every_verdict_has_all_that_is_read(
    verdict: Verdict, vehicle: VehicleFile, channels: tuple[str, ...]
) -> None:
    content = strict(
        diagnosis_content(tracing_of(verdict, vehicle, channels=channels), "2026-01-01T00:00:00Z")
    )
    assert content["schema"] == "flightid/diagnosis/2"
    assert content["verdict"] == verdict.value
    for when in ("before", "after"):
        assert set(content["parameters"][when]) == set(vehicle.derivatives)
        for entry in content["parameters"][when].values():
            assert {"value", "std"} <= set(entry)
        assert set(content["error"][when]) == {"rmse", "nrmse", "r2", "theil"}
        assert set(content["error"][when]["rmse"]) == set(channels)
        assert isinstance(content["residual_tests"][when], list)
    assert content["error"]["held_out"] is True
    assert set(content["error"]["noise_floor"]) == set(channels)
    units = {"alpha": "rad", "q": "rad/s", "nz": "g", "altitude": "m"}
    assert content["error"]["unit"] == {name: units[name] for name in channels}
    assert {"steps", "candidates", "warnings", "record", "versions"} <= set(content)
    assert content["record"] == {"looked_at": [], "trusted": False, "findings": [], "masked": {}}
    assert set(content["inputs"]) >= {"records", "sha256"}
    assert all(std > 0 for path, std in numbers(content) if path.endswith(".std"))


@pytest.mark.parametrize("verdict", list(Verdict))
def test_effects_carry_name_alternatives_and_parameters(verdict: Verdict) -> None:
    tracing = tracing_of(verdict)
    effects = strict(diagnosis_content(tracing, ""))["effects"]
    assert [effect["name"] for effect in effects] == [
        claim.name for claim in tracing.diagnosis.effects
    ]
    for effect, claim in zip(effects, tracing.diagnosis.effects, strict=True):
        assert effect["alternatives"] == list(claim.alternatives)
        assert effect["parameters"] == {
            name: {"value": q.value, "std": q.std, "unit": q.unit}
            for name, q in claim.parameters.items()
        }
        # Absent means claimed: only a hint is marked.
        assert effect.get("claimed", True) is claim.claimed
        assert ("claimed" in effect) is not claim.claimed


def test_low_order_equivalent_fills_derived_with_its_delay() -> None:
    tracing = tracing_of(Verdict.TRACED, LOES)
    without = replace(
        tracing.diagnosis,
        derived_after={
            name: q for name, q in tracing.diagnosis.derived_after.items() if name != "delay"
        },
    )
    content = strict(diagnosis_content(replace(tracing, diagnosis=without), ""))
    assert set(content["derived"]) == {"natural_frequency", "damping_ratio", "delay"}
    assert content["derived"]["delay"]["value"] == content["parameters"]["after"]["delay"]["value"]
    assert set(content["parameters"]["after"]) == {
        "L_alpha",
        "M_alpha",
        "L_delta",
        "M_delta",
        "L_q",
        "M_q",
        "inv_tau",
        "delay",
    }


def test_candidates_carry_all_evidence() -> None:
    tracing = tracing_of(Verdict.TRACED)
    found = strict(diagnosis_content(tracing, ""))["candidates"]
    assert [c["name"] for c in found] == [c.name for c in tracing.diagnosis.candidates]
    for c in found:
        assert {
            "round",
            "within",
            "name",
            "gain",
            "weight",
            "fitted",
            "parameters",
            "collinear_with",
        } == set(c)
    assert found[0]["gain"] == 420.0 and found[0]["weight"] == pytest.approx(414.9)
    assert [c["fitted"] for c in found] == [True, True, False, False]


@pytest.mark.parametrize("bad", [math.nan, math.inf, 0.0, -1.0])
def test_a_sigma_that_is_none_becomes_a_finite_positive_one(bad: float) -> None:
    tracing = tracing_of(Verdict.TRACED)
    after = {**tracing.diagnosis.after, "CL_q": Quantity(6.0, bad, "1/rad")}
    content = strict(
        diagnosis_content(replace(tracing, diagnosis=replace(tracing.diagnosis, after=after)), "")
    )
    assert 0.0 < content["parameters"]["after"]["CL_q"]["std"] <= LARGEST
    told = any("CL_q" in warning and "not determine" in warning for warning in content["warnings"])
    assert told is not math.isfinite(bad)


def test_errors_that_ran_away_stay_finite() -> None:
    tracing = tracing_of(Verdict.TRACED)
    d = tracing.diagnosis
    broken = replace(
        d.error_before,
        rmse={"alpha": math.inf, "q": math.nan, "nz": 1e200},
        r2={"alpha": -math.inf, "q": 0.5, "nz": 0.1},
    )
    error = strict(
        diagnosis_content(replace(tracing, diagnosis=replace(d, error_before=broken)), "")
    )["error"]["before"]
    assert set(error["rmse"]) == {"alpha", "q", "nz"}
    assert all(0.0 <= value <= LARGEST for value in error["rmse"].values())
    assert error["r2"] == {"q": 0.5, "nz": 0.1}


def test_inputs_name_every_file_by_its_content() -> None:
    tracing = tracing_of(Verdict.CONSISTENT, validations=2)
    own = replace(
        tracing,
        inputs=replace(tracing.inputs, effects=(InputFile("my_effects.py", "3" * 64),)),
        held_out_from=4.0,
    )
    inputs = strict(diagnosis_content(own, ""))["inputs"]
    assert inputs["records"] == ["train.csv"] and inputs["sha256"] == ["0" * 64]
    assert (
        inputs["validate"] == ["validate.csv", "validate.csv"]
        and len(inputs["validate_sha256"]) == 2
    )
    assert (
        inputs["vehicle"] == "v.toml"
        and inputs["effects"] == "my_effects.py"
        and inputs["held_out_from"] == 4.0
    )
