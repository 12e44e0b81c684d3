"""Kinematics beside a diagnosis: agreement by 3 sigmas, nothing claimed that they cannot tell,
never a failure.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    SensorEstimate,
    SensorFinding,
)
from ident.compatibility.trials import FaultQuantity as Value
from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.compatibility import check_files
from scenarios.diagnosis.kinematics import (
    AGREES,
    CONTRADICTS,
    DIFFERS,
    IN_KIND,
    MOST_SAMPLES,
    NOTHING,
    Kinematics,
    agreements,
    kinematics_of,
    kinematics_of_files,
    named_by,
    shortened,
    spread,
    unnamed,
)
from scenarios.diagnosis.tables import kinematics_lines
from scenarios.diagnosis.text import diagnosis_content, diagnosis_text
from scenarios.diagnosis.wording import Wording
from scenarios.files.measured.columns import read_record_files
from scenarios.files.vehicles import read_any_vehicle
from scenarios.files.writing import json_text, write_record
from scenarios.preparation.plan import Request, Segment
from sim.maths import G0
from sim.record import Channel, Record
from tests.diagnoses import measured_record, tracing_of
from tests.integration.command_line import VEHICLE
from tests.oracles.flight_path import Sensors
from tests.unit.ident.compatibility.flights import FOUR, SPEED, record

AT_130 = CompatibilitySettings(airspeed=130.0)
LATE = Claim("sensor-delay:alpha", {"delay": Quantity(0.061, 0.002, "s")}, ("sensor-lag:alpha",))


def checked(
    findings: Sequence[SensorFinding] = (), estimates: Sequence[SensorEstimate] = ()
) -> Kinematics:
    joint = CheckResult(("a.csv",), tuple(estimates), (), tuple(findings), {})
    return Kinematics(
        ("a.csv",),
        Compatibility(("alpha", "q", "nz"), {}, joint, (joint,), (), ("a scale leaves no trace",)),
    )


def finding(
    name: str,
    value: float,
    std: float,
    group: tuple[str, ...] = (),
    *,
    supported: bool = True,
    kind: str = "delay",
) -> SensorFinding:
    return SensorFinding(
        name.partition(":")[2] or "alpha", kind, value, std, "s", 30.0, supported, group, name
    )


# ruled out in the place of what stands
INSTEAD = replace(finding("sensor-delay:alpha", 0.055, 0.004, supported=False), lost=40.0)


def estimate(
    value: float, std: float, *, told: bool = True, difference: float = 0.0, kind: str = "delay"
) -> SensorEstimate:
    name = f"sensor-{kind}:alpha"
    return SensorEstimate(
        name, "alpha", kind, "s", Value(value, std), Value(value, std), difference, 1.0, 0.5, told
    )


def test_a_fault_on_which_the_methods_disagree_is_not_named() -> None:
    late = finding("sensor-delay:alpha", 0.06, 0.002, ("sensor-lag:alpha",))
    agreed = checked([late], [estimate(0.06, 0.002, difference=1.0)])
    assert named_by(agreed) == [("sensor-delay:alpha", "sensor-lag:alpha")]
    assert named_by(checked([late], [estimate(0.06, 0.002, difference=5.0)])) == []
    assert named_by(None) == []


@pytest.mark.parametrize(
    ("kinematics", "says"),
    [
        (checked([finding("sensor-delay:alpha", 0.058, 0.004)]), AGREES),
        (checked([finding("sensor-delay:alpha", 0.074, 0.004)]), AGREES),  # 2.9 sigmas
        (checked([finding("sensor-delay:alpha", 0.076, 0.004)]), DIFFERS),  # 3.4 sigmas
        (checked([finding("sensor-lag:alpha", 0.050, 0.004, kind="lag")]), AGREES),
        # another of the group, of another size
        (checked([finding("sensor-lag:alpha", 0.020, 0.004, kind="lag")]), DIFFERS),
        # 1.5 sigmas, and 3 ms are what interpolation makes
        (checked([finding("sensor-delay:alpha", 0.058, 0.0001)]), AGREES),
        # metres and seconds
        (checked([finding("vane-offset", 9.0, 1.0, ("sensor-lag:alpha",), kind="arm")]), IN_KIND),
        (checked([INSTEAD, finding("vane-offset", 9.0, 1.0, kind="arm")]), CONTRADICTS),
        (checked([finding("sensor-delay:alpha", 0.058, 0.004, supported=False)]), NOTHING),
        (checked([], [estimate(0.060, 0.005)]), AGREES),
        (checked([], [estimate(0.001, 0.005)]), CONTRADICTS),
        (checked([], [estimate(0.030, 0.020)]), NOTHING),
        (checked([], [estimate(0.001, 0.005, told=False)]), NOTHING),
        (checked([], [estimate(0.001, 0.005, difference=4.0)]), NOTHING),
        (checked([], [estimate(0.001, 0.005, kind="lag")]), NOTHING),
        (checked(), NOTHING),
    ],
)
def test_a_late_channel_against_the_kinematics(kinematics: Kinematics, says: str) -> None:
    (found,) = agreements(kinematics, [LATE])
    assert (found.effect, found.says) == ("sensor-delay:alpha", says)
    assert (
        found.sentence.startswith("kinematics alone ")
        and {AGREES: "agrees", CONTRADICTS: "contradicts"}.get(says, "") in found.sentence
    )


def test_a_scale_is_absent_at_one() -> None:
    claim = Claim("sensor-scale:alpha", {"scale": Quantity(1.10, 0.02, "1")})
    for value, says in ((1.0, CONTRADICTS), (1.09, AGREES)):
        assert (
            agreements(checked([], [estimate(value, 0.01, kind="scale")]), [claim])[0].says == says
        )
    assert agreements(checked([], [estimate(1.03, 0.05, kind="scale")]), [claim])[0].says == NOTHING


def test_only_sensor_effects_are_compared_and_others_found_are_told() -> None:
    kinematics = checked(
        [
            finding("sensor-delay:q", 0.04, 0.004, ("sensor-lag:q",)),
            finding("sensor-lag:q", 0.04, 0.004, ("sensor-delay:q",), kind="lag"),
        ]
    )
    claims = [
        Claim("input-delay", {"delay": Quantity(0.06, 0.01, "s")}),
        Claim("gust-turbulence", {}),
    ]
    assert agreements(kinematics, claims) == []
    assert [each.name for each in unnamed(kinematics, claims)] == ["sensor-delay:q"]
    lines = kinematics_lines(kinematics, claims, Wording())
    assert lines == [
        "kinematics alone give sensor-delay:q 0.0400 +- 0.0040 s, the pitch rate is read 0.040 s "
        "late (delay or lag: both fit these data equally well); "
        "the diagnosis does not name it",
        "kinematics were checked on a.csv: fitted data alone",
    ]
    assert kinematics_lines(checked(), [], Wording())[0] == "kinematics alone find no sensor fault"


@pytest.mark.long
def test_a_late_vane_is_found_in_a_flight_and_agrees() -> None:
    kinematics = kinematics_of(
        [record(sensors=Sensors(delay={"alpha": 0.06}), seed=1)],
        CompatibilitySettings(airspeed=SPEED),
    )
    (found,) = agreements(kinematics, [LATE])
    assert found.says == AGREES and found.found is not None
    assert found.found.value == pytest.approx(0.06, abs=3.0 * found.found.std + 0.005)
    (other,) = agreements(
        kinematics, [replace(LATE, parameters={"delay": Quantity(0.2, 0.002, "s")})]
    )
    assert other.says in (DIFFERS, CONTRADICTS)


@pytest.mark.long
def test_a_record_in_a_bank_is_no_witness_of_level_wings() -> None:
    """Whether its bank angle is recorded or only the rates that tell of it; a level one beside it
    is heard.
    """
    level = record(sensors=Sensors(delay={"alpha": 0.06}), seed=1)
    time = level.time
    phi = (
        np.radians(40.0) * 0.5 * (1.0 - np.cos(2.0 * np.pi * np.clip((time - 5.0) / 6.0, 0.0, 1.0)))
    )
    rates = {"p": np.gradient(phi, time), "r": G0 / SPEED * np.tan(phi)}
    banked = replace(
        level,
        name="banked.csv",
        outputs=(
            *level.outputs,
            *(Channel.of(name, "rad/s", values) for name, values in rates.items()),
        ),
    )
    known = replace(banked, outputs=(*banked.outputs, Channel.of("phi", "rad", phi)))
    for turning in (banked, known):
        alone = kinematics_of([turning], CompatibilitySettings(airspeed=SPEED))
        assert alone.result is None and "p and r show that the wings were up to" in alone.why
        assert kinematics_of([level, turning], CompatibilitySettings(airspeed=SPEED)).records == (
            level.name,
        )


@pytest.mark.parametrize(
    "records",
    [
        (),
        (measured_record(("alpha", "q")),),
        (measured_record(count=14),),
        (
            replace(
                measured_record(),
                outputs=tuple(
                    replace(c, values=np.where(c.valid, 1e9, 0.0))
                    for c in measured_record().outputs
                ),
            ),
        ),
        (
            replace(
                measured_record(),
                outputs=tuple(
                    Channel.of(c.name, c.unit, np.zeros(len(c.values)))
                    for c in measured_record().outputs
                ),
            ),
        ),
    ],
)
def test_what_cannot_be_checked_is_one_line_and_no_failure(records: tuple[Record, ...]) -> None:
    kinematics = kinematics_of(records, AT_130)
    lines = kinematics_lines(kinematics, [LATE], Wording())
    assert lines and all("\n" not in line for line in lines)
    if kinematics.result is None:
        assert lines == [kinematics.why] and agreements(kinematics, [LATE]) == []


def test_of_many_samples_every_record_keeps_its_liveliest_stretch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[Record] = []

    def check(
        records: Sequence[Record], settings: CompatibilitySettings, *, each: bool, six: bool
    ) -> object:
        assert not each and not six
        seen.extend(records)
        return checked().result

    monkeypatch.setattr("ident.compatibility.check.compatibility", check)
    many = [replace(measured_record(count=MOST_SAMPLES // 2), name=f"{n}.csv") for n in range(4)]
    assert kinematics_of([measured_record(("alpha", "q")), *many], AT_130).records == (
        "0.csv",
        "1.csv",
        "2.csv",
        "3.csv",
    )
    assert all(len(each) == MOST_SAMPLES // 4 for each in seen)
    lively = record(seed=1)
    (cut,) = shortened([lively], 200)
    power = [
        float(np.var(lively["q"].values[first : first + 200])) for first in range(len(lively) - 199)
    ]
    assert len(cut) == 200 and float(np.var(cut["q"].values)) > 0.95 * max(power)
    assert [len(each) for each in shortened([lively, lively.window(0.0, 2.0)], 300)] == [
        249,
        51,
    ]


def test_of_too_many_records_those_of_spread_airspeeds_are_kept() -> None:
    def at(speed: float) -> Record:
        one = measured_record()
        return replace(
            one,
            name=f"{speed:g}",
            outputs=(*one.outputs, Channel.of("airspeed", "m/s", np.full(len(one), speed))),
        )

    kept = [
        each.name
        for each in spread([at(speed) for speed in (100.0, 101.0, 102.0, 103.0, 200.0, 150.0)], 3)
    ]
    assert kept == ["100", "102", "200"]
    assert [
        each.name for each in spread([replace(measured_record(), name=str(i)) for i in range(5)], 3)
    ] == ["0", "1", "2"]


def test_an_equally_likely_fault_is_printed_with_its_size_and_the_records_are_named() -> None:
    both = [
        finding("sensor-delay:alpha", 0.058, 0.004, ("sensor-lag:alpha",)),
        finding("sensor-lag:alpha", 0.057, 0.004, ("sensor-delay:alpha",), kind="lag"),
    ]
    (found,) = agreements(checked(both), [LATE])
    assert "or, equally well, sensor-lag:alpha 0.0570 +- 0.0040 s: agrees" in found.sentence
    kinematics = Kinematics(("a.csv", "b.csv"), checked(both).result, held_out=True)
    assert kinematics.source == (
        "kinematics were checked on a.csv and b.csv: fitted and held-out data together"
    )
    many = Kinematics(tuple(f"{n}.csv" for n in range(6)), None)
    assert "0.csv, 1.csv, 2.csv, 3.csv and 2 more: fitted data alone" in many.source


def test_what_differs_is_said_with_both_values() -> None:
    (found,) = agreements(checked([finding("sensor-delay:alpha", 0.030, 0.002)]), [LATE])
    assert (
        found.says == DIFFERS
        and "differs: 0.0300 +- 0.0020 s against 0.0610 +- 0.0020 s in the diagnosis"
        in found.sentence
    )
    assert "agrees" not in found.sentence


def test_the_twin_of_a_claim_is_no_fault_that_the_diagnosis_missed() -> None:
    arm = checked([finding("vane-offset", 2.0, 0.2, ("accelerometer-offset:nz",), kind="arm")])
    assert unnamed(arm, [Claim("time-base", {})]) != []
    assert unnamed(arm, [Claim("accelerometer-offset:nz", {"arm": Quantity(-2.0, 0.2, "m")})]) == []
    slow = checked([finding("sensor-scale:alpha", 0.9, 0.01, kind="scale")])
    assert unnamed(slow, [Claim("time-base", {"factor": Quantity(1.1, 0.01, "1")})]) == []


@pytest.mark.long
def test_files_are_checked_with_every_channel_as_flightid_check_does(tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text(VEHICLE.replace("200.64984", str(SPEED)))
    for number in (1, 2):
        write_record(
            tmp_path,
            record((*FOUR, "ax"), Sensors(delay={"theta": 0.06}), seed=number).window(0.0, 12.0),
            f"flight{number}",
        )
    paths = [tmp_path / "flight1.csv", tmp_path / "flight2.csv"]
    kinematics = kinematics_of_files(
        [(file, Segment()) for file in read_record_files(paths)],
        read_any_vehicle(tmp_path / "vehicle.toml"),
    )
    told = check_files(Request(tuple(paths))).result
    assert kinematics.result is not None and kinematics.records == ("flight1.csv", "flight2.csv")
    assert kinematics.result.joint.estimates == told.joint.estimates and "sensor-delay:theta" in [
        each.name for each in told.findings if each.supported
    ]
    (tmp_path / "strange.csv").write_text("time,fuel\n0,1\n1,2\n")
    strange = kinematics_of_files(
        [(file, Segment()) for file in read_record_files([tmp_path / "strange.csv"])],
        read_any_vehicle(tmp_path / "vehicle.toml"),
    )
    assert strange.result is None and "strange.csv" in strange.why


def test_study_has_it_in_its_file_and_on_the_terminal() -> None:
    kinematics = checked([finding("sensor-delay:alpha", 0.058, 0.004, ("sensor-lag:alpha",))])
    tracing = tracing_of(Verdict.PARTIAL)
    told = replace(
        tracing, diagnosis=replace(tracing.diagnosis, effects=(LATE,)), kinematics=kinematics
    )
    content = json.loads(json_text(diagnosis_content(told, "")))["compatibility"]
    assert content["checked"] is True and content["records"] == ["a.csv"]
    (found,) = content["findings"]
    assert (found["name"], found["alternatives"]) == ("sensor-delay:alpha", ["sensor-lag:alpha"])
    assert found["parameters"] == {"delay": {"value": 0.058, "std": 0.004, "unit": "s"}}
    (agreement,) = content["agreement"]
    assert (agreement["effect"], agreement["says"]) == ("sensor-delay:alpha", "agrees")
    assert "agrees with the diagnosis" in " ".join(diagnosis_text(told).split())
    unchecked = replace(told, kinematics=Kinematics((), None, "nothing to check"))
    assert diagnosis_content(unchecked, "")["compatibility"] == {
        "records": [],
        "checked": False,
        "sentences": ["nothing to check"],
    }
    assert "compatibility" not in diagnosis_content(tracing, "")
