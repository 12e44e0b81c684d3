"""Files to prepared records: az, segments, hold by the fit, notes."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.measured.columns import read_record_files
from scenarios.files.records import read_record
from scenarios.preparation import declared_model
from scenarios.preparation.declared_model import gain_of_linear_inputs, held_by_computer
from scenarios.preparation.measured_inputs import with_flow, with_load_factors
from scenarios.preparation.plan import Plan, Segment
from scenarios.preparation.reading import for_model, prepare
from sim.errors import RecordError
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import model_from_constants
from tests.oracles.falling_speed import FallingSpeed, fly_falling
from tests.oracles.held_fighter import CONSTANTS as FIGHTER
from tests.oracles.held_fighter import drawn_pair
from tests.preparing import OUTPUTS, declared, noisy, record_of, write_flown

G0 = 9.80665


@pytest.fixture(scope="module")
def linear() -> FallingSpeed:
    return fly_falling(weight=False, fall=0.0)


@pytest.fixture(scope="module")
def held() -> FallingSpeed:
    return fly_falling(weight=False, fall=0.0, held=True)


@pytest.mark.long
def test_az_serves_as_nz_where_there_is_none(tmp_path: Path, linear: FallingSpeed) -> None:
    with_nz = write_flown(tmp_path / "nz.csv", linear)
    rows = np.array([linear.time, linear.elevator, linear.alpha, linear.q, -(linear.nz + 1.0)]).T
    header = "time,elevator,alpha,q,az [g]"
    np.savetxt(tmp_path / "az.csv", rows, delimiter=",", header=header, comments="", fmt="%.12g")
    (first,), (second,) = (
        prepare(read_record_files([path]), declared(), Plan()).fitted
        for path in (with_nz, tmp_path / "az.csv")
    )
    assert second.output_names == OUTPUTS and second["nz"].unit == "g"
    np.testing.assert_allclose(second["nz"].values, first["nz"].values + 1.0, atol=1e-10)
    notes = prepare(read_record_files([tmp_path / "az.csv"]), declared(), Plan()).notes
    assert any(note == "az.csv: nz is -az/9.80665" for note in notes)


def test_nz_that_is_there_is_taken_and_a_broken_az_is_not_looked_at(tmp_path: Path) -> None:
    (tmp_path / "both.csv").write_text(
        "time,elevator,alpha,nz,az\n0,0,0,1,broken\n1,0,0,2,broken\n"
    )
    record = read_record(tmp_path / "both.csv", ["elevator"], OUTPUTS, instead={"nz": "az"})
    assert record.output_names == ("alpha", "nz") and record["nz"].values.tolist() == [1.0, 2.0]
    (tmp_path / "alone.csv").write_text("time,elevator,az\n0,0,-9.80665\n1,0,\n2,0,-19.6133\n")
    alone, _ = with_load_factors(
        read_record(tmp_path / "alone.csv", ["elevator"], OUTPUTS, instead={"nz": "az"})
    )
    assert alone["nz"].valid.tolist() == [True, False, True] and alone["nz"].values[
        [0, 2]
    ].tolist() == [1.0, 2.0]
    (tmp_path / "up.csv").write_text("time,elevator,az [g]\n0,0,2\n1,0,2\n")
    with pytest.raises(
        RecordError,
        match=(
            r"up.csv, channel az: the middle of az is \+19.6 m/s2, but az is positive down: -9.81"
        ),
    ):
        with_load_factors(
            read_record(tmp_path / "up.csv", ["elevator"], OUTPUTS, instead={"nz": "az"})
        )


@pytest.mark.parametrize(
    ("level", "refused"), [(-1.0, True), (-0.7, True), (-0.6, False), (0.0, False), (1.0, False)]
)
def test_an_accelerometer_that_reads_inverted_flight_is_refused(
    level: float, refused: bool
) -> None:
    """One g the wrong way round, give or take the half that a scale or a steady pull makes of it;
    no g is a record of changes.
    """
    time = np.arange(50) * 0.1
    record = Record(
        time, (), (Channel.of("az", "m/s2", -9.80665 * level + np.sin(7.0 * time)),), name="r.csv"
    )
    if refused:
        with pytest.raises(RecordError, match="az is positive down"):
            with_load_factors(record)
        return
    made, _ = with_load_factors(record)
    assert np.median(made["nz"].values) == pytest.approx(level, abs=0.05)


def test_lateral_and_axial_accelerometers_keep_their_sign_and_are_never_refused() -> None:
    time = np.arange(20) * 0.1
    forces = {"ay": np.full(20, -15.0), "ax": np.full(20, -9.80665), "az": np.full(20, -19.6133)}
    made, told = with_load_factors(
        Record(time, (), tuple(Channel.of(name, "m/s2", row) for name, row in forces.items()))
    )
    assert {name: made[name].values[3] for name in made.output_names} == pytest.approx(
        {"ny": -15.0 / 9.80665, "nx": -1.0, "nz": 2.0}
    )
    assert [sentence.partition(": ")[2] for sentence in told] == [
        "nz is -az/9.80665",
        "ny is ay/9.80665",
        "nx is ax/9.80665",
    ]


def test_further_channels_that_cannot_be_read_as_such_count_as_absent(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("time,q,airspeed_raw,dynamic_pressure\n0,1,x,\n1,1,y,\n")
    assert read_record(path, (), ["q"], optional=["airspeed", "dynamic_pressure"]).output_names == (
        "q",
    )
    path.write_text("time,q,airspeed_kt\n0,1,100\n1,1,x\n")
    with pytest.raises(RecordError, match="row 3, column 'airspeed_kt': 'x' is not a number"):
        read_record(path, (), ["q"], optional=["airspeed"])


def test_segments_become_records_of_their_own(tmp_path: Path, linear: FallingSpeed) -> None:
    path = write_flown(tmp_path / "r.csv", linear)
    plan = Plan((Segment(2.0, 8.0), Segment(11.5, 19.0)))
    ready = prepare(
        read_record_files([path]),
        declared(),
        plan,
        validate=read_record_files([write_flown(tmp_path / "v.csv", linear)]),
    )
    assert [record.name for record in ready.fitted] == ["r.csv[2-8 s]", "r.csv[11.5-19 s]"]
    assert [(record.time[0], record.time[-1]) for record in ready.fitted] == [
        (2.0, 8.0),
        (11.5, 19.0),
    ]
    assert [(record.name, len(record)) for record in ready.validation] == [
        ("v.csv", len(linear.time))
    ]
    (alone,) = prepare(read_record_files([path]), declared(), Plan((Segment(2.0, 8.0),))).fitted
    assert alone.name == "r.csv" and len(alone) == 301


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_the_data_tell_linear_from_held(
    seed: int, tmp_path: Path, linear: FallingSpeed, held: FallingSpeed
) -> None:
    for flown, due in ((linear, Hold.LINEAR), (held, Hold.PREVIOUS)):
        path = write_flown(tmp_path / "r.csv", flown, rng=np.random.default_rng(seed))
        ready = prepare(read_record_files([path]), declared(), Plan())
        assert ready.fitted[0].hold is due
        assert any(
            "inputs linear between samples" in note and "--hold previous" in note
            for note in ready.notes
        ) == (due is Hold.LINEAR)


@pytest.mark.long
@pytest.mark.parametrize(
    "factors",
    [{"Cm_alpha": -1.0}, {"Cm_alpha": -3.0}, {"Cm_q": -1.0}, {"Cm_alpha": -1.0, "Cm_q": -1.0}],
)
@pytest.mark.parametrize("seed", range(2))
def test_starting_values_do_not_turn_the_reading(
    seed: int, factors: dict[str, float], linear: FallingSpeed, held: FallingSpeed
) -> None:
    """Starts of the other sign lead single fits into minima beside the least one; the comparison is
    of the least ones.
    """
    values = {name: factor * declared().parameters[name].value for name, factor in factors.items()}
    led_astray = declared().with_parameters(declared().parameters.with_values(values))
    for flown, linear_is_right in ((linear, True), (held, False)):
        record = record_of(flown, rng=np.random.default_rng(seed))
        right = gain_of_linear_inputs([record], declared(), with_flow)
        assert (right > 10.0) is linear_is_right
        assert gain_of_linear_inputs([record], led_astray, with_flow) == pytest.approx(
            right, abs=2.0
        )


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_wild_points_do_not_turn_the_reading(
    seed: int, linear: FallingSpeed, held: FallingSpeed
) -> None:
    for flown, linear_is_right in ((linear, True), (held, False)):
        record = record_of(flown, rng=np.random.default_rng(seed))
        values = record["alpha"].values.copy()
        values[[101, 402, 733]] += np.array([0.3, -0.4, 0.3])
        wild = replace(
            record,
            outputs=tuple(
                c.of(c.name, c.unit, values) if c.name == "alpha" else c for c in record.outputs
            ),
        )
        gain = gain_of_linear_inputs([wild], declared(), with_flow)
        assert (gain > 10.0) is linear_is_right and gain == pytest.approx(
            gain_of_linear_inputs([record], declared(), with_flow), rel=0.1, abs=2.0
        )


def test_a_sidecar_and_the_user_decide_before_the_data(
    tmp_path: Path, linear: FallingSpeed
) -> None:
    path = write_flown(tmp_path / "r.csv", linear, rng=np.random.default_rng(0))
    (by_hand,) = prepare(read_record_files([path]), declared(), Plan(hold=Hold.PREVIOUS)).fitted
    assert by_hand.hold is Hold.PREVIOUS
    (tmp_path / "r.json").write_text(
        json.dumps({"schema": "flightid/record/1", "hold": "previous"})
    )
    (by_sidecar,) = prepare(read_record_files([path]), declared(), Plan()).fitted
    assert by_sidecar.hold is Hold.PREVIOUS
    (tmp_path / "r.json").write_text(
        json.dumps({"schema": "flightid/record/1", "units": {"alpha": "rad"}})
    )
    (silent,) = prepare(read_record_files([path]), declared(), Plan()).fitted
    assert silent.hold is Hold.LINEAR


def test_a_commanded_input_is_held_whatever_the_fit_says(held: FallingSpeed) -> None:
    steps = np.where((held.time > 2.0) & (held.time < 4.0), 0.02, 0.0)
    record = record_of(held)
    stepped = record.__class__(
        record.time, (record.inputs[0].of("elevator", "rad", steps),), record.outputs
    )
    assert held_by_computer(stepped) and not held_by_computer(record)
    assert gain_of_linear_inputs([stepped], declared(), with_flow) == 0.0


@pytest.mark.long
def test_trims_and_the_measured_speed_are_told(tmp_path: Path) -> None:
    flown = fly_falling(weight=True)
    columns = noisy(flown)
    resting = np.where(flown.time < 1.2, 0.0, columns["elevator"]) + 0.03
    rows = np.array(
        [flown.time, resting, *(columns[name] for name in OUTPUTS), columns["airspeed"]]
    ).T
    np.savetxt(
        tmp_path / "r.csv",
        rows,
        delimiter=",",
        header="time,elevator,alpha,q,nz,airspeed",
        comments="",
        fmt="%.12g",
    )
    ready = prepare(read_record_files([tmp_path / "r.csv"]), declared(), Plan())
    told = "\n".join(ready.notes)
    taken = re.search(r"r\.csv: trim of elevator taken off, ([0-9.]+) deg", told)
    assert taken is not None and abs(np.radians(float(taken[1])) - 0.03) < 0.001
    assert "measured airspeed used, 117 to 130 m/s (declared 130 m/s)" in told
    assert (
        "the lift that carries the weight follows the measured pressure" in told
        and "speed-variation is no candidate" in told
    )
    assert ready.fitted[0].input_names == ("elevator", "airspeed_change", "lift")
    assert (
        ready.measured[0].output_names == (*OUTPUTS, "airspeed")
        and ready.measured[0]["elevator"].values[0] == 0.03
    )


def test_a_record_of_perturbations_alone_has_no_trim_lift(tmp_path: Path) -> None:
    path = write_flown(
        tmp_path / "r.csv",
        fly_falling(weight=False),
        (*OUTPUTS, "airspeed"),
        np.random.default_rng(0),
    )
    ready = prepare(read_record_files([path]), declared(), Plan())
    assert ready.fitted[0].input_names == ("elevator", "airspeed_change")
    assert any("perturbations alone fit better" in note for note in ready.notes)


@pytest.mark.long
@pytest.mark.parametrize("seed", [16, 20, 62, 80])
def test_an_unstable_fighter_under_its_controller_carries_its_weight(seed: int) -> None:
    """Fits that had not converged, or with a bias of nz of several g, made records of perturbations
    alone of these.
    """
    records, derivatives = drawn_pair(seed)
    ready = for_model(
        [(record, True) for record in records], model_from_constants("rigid", FIGHTER, derivatives)
    )
    assert not any("perturbations alone" in note for note in ready.notes)
    assert all("lift" in record.input_names for record in ready.fitted)


@pytest.mark.long
def test_a_fit_that_has_not_converged_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    records, derivatives = drawn_pair(16)
    model = model_from_constants("rigid", FIGHTER, derivatives)
    interpretations = with_flow(model, records), with_flow(model, records, trim_lift=False)
    monkeypatch.setattr(
        declared_model,
        "COMPARISON_SETTINGS",
        replace(declared_model.COMPARISON_SETTINGS, iterations=2),
    )
    found = declared_model.compared_interpretations(*interpretations, OUTPUTS)
    assert found.gain == 0.0 and found.why_open == "a fit has not converged"


def test_a_bias_far_outside_the_range_of_the_samples_is_no_trim() -> None:
    """Of a load factor between 0.6 and 2.2 g a trim of 1 g, of 0 g or of 3 g can be; of -3 g it
    cannot, nor of 5 g.
    """
    measured = np.linspace(0.6, 2.2, 50)
    assert [
        declared_model.implausible_bias(bias, measured) for bias in (1.0, 0.0, 3.0, -3.0, 5.0)
    ] == [False, False, False, True, True]


@pytest.mark.long
def test_a_fit_with_an_implausible_bias_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Controls as recorded, off their trim: biases then stand for the motion that the trim
    deflection would make.
    """
    records, derivatives = drawn_pair(80)
    model = model_from_constants("rigid", FIGHTER, derivatives)
    interpretations = with_flow(model, records), with_flow(model, records, trim_lift=False)
    monkeypatch.setattr(declared_model, "from_trim", lambda record, model: record)
    found = declared_model.compared_interpretations(*interpretations, OUTPUTS)
    assert found.gain == 0.0 and "a fit needs a bias of" in found.why_open


def test_controls_count_from_their_trim_or_their_mean(held: FallingSpeed) -> None:
    record = record_of(held)
    values = record["elevator"].values
    off = replace(record, inputs=(Channel.of("elevator", "rad", values + 0.2),))
    rested = declared_model.from_trim(off, declared())["elevator"].values
    # the rest ends where the elevator has left a twentieth of its span
    np.testing.assert_allclose(rested, values, atol=1e-3)
    moving = replace(
        off,
        time=record.time[100:],
        inputs=(Channel.of("elevator", "rad", off["elevator"].values[100:]),),
        outputs=(),
    )
    assert abs(np.mean(declared_model.from_trim(moving, declared())["elevator"].values)) < 1e-12
    assert (
        declared_model.from_trim(record, declared())["elevator"].values.tolist() == values.tolist()
    )
