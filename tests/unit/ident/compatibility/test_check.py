"""What a check says of sound and of faulty sensors, of one record and of several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.fitting import projected_whitener
from ident.compatibility.trials import Compatibility, CompatibilitySettings
from sim.errors import RecordError
from sim.record import Channel, Record
from tests.oracles import undeclared_flights as flights
from tests.oracles.flight_path import UNITS, Sensors
from tests.unit.ident.compatibility.flights import ALL, FOUR, NOISE, SPEED, THREE, record

SETTINGS = CompatibilitySettings(SPEED)


def standing(found: Compatibility) -> list[str]:
    return [finding.name for finding in found.findings if finding.supported]


@pytest.mark.sampled
@pytest.mark.parametrize("channels", [THREE, FOUR, ALL])
def test_sound_sensors_raise_nothing_and_both_methods_agree(channels: tuple[str, ...]) -> None:
    found = compatibility([record(channels, seed=3)], SETTINGS)
    assert standing(found) == []
    assert all(item.agrees for item in found.joint.estimates)
    assert found.joint.noise_std["alpha"] == pytest.approx(0.0026, rel=0.1)
    assert projected_whitener.cache_info().currsize == 0, (
        "what was made for this check is not kept after it"
    )


@pytest.mark.long
@pytest.mark.parametrize("channel", THREE)
def test_a_late_channel_stands_with_its_delay_within_the_standard_deviation(channel: str) -> None:
    found = compatibility([record(sensors=Sensors(delay={channel: 0.06}), seed=1)], SETTINGS)
    (late,) = [finding for finding in found.findings if finding.name == f"sensor-delay:{channel}"]
    assert late.supported and {finding.name for finding in found.findings if finding.supported} == {
        late.name,
        *late.group,
    }
    assert abs(late.value - 0.06) < 3.0 * late.std and late.std < 0.005
    (both,) = [item for item in found.joint.estimates if item.name == late.name]
    assert abs(both.output_error.value - 0.06) < 3.0 * both.output_error.std and both.agrees


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("sensors", "name", "value"),
    [
        (Sensors(scale={"q": 1.06}), "sensor-scale:q", 1.06),
        (Sensors(scale={"nz": 0.92}), "sensor-scale:nz", 0.92),
        (Sensors(drift={"nz": 0.006}), "sensor-drift:nz", 0.006),
        (Sensors(arm=8.0), "vane-offset", 8.0),
    ],
)
def test_other_faults_stand_under_the_names_of_their_effects(
    sensors: Sensors, name: str, value: float
) -> None:
    found = compatibility([record(sensors=sensors, seed=2)], SETTINGS)
    (fault,) = [finding for finding in found.findings if finding.name == name]
    assert fault.supported and abs(fault.value - value) < 3.5 * fault.std
    assert set(standing(found)) == {name, *fault.group}


@pytest.mark.slow
@pytest.mark.slow
def test_several_records_share_the_fault_and_each_shows_it_by_itself() -> None:
    late = Sensors(delay={"alpha": 0.05}, bias={"nz": 0.1})
    records = [
        record(sensors=late if i else replace(late, bias={}), seed=i, name=f"flight {i}")
        for i in range(3)
    ]
    found = compatibility(records, SETTINGS)
    joint = next(item for item in found.joint.estimates if item.name == "sensor-delay:alpha")
    together = compatibility(records, SETTINGS, each=False)
    assert together.single == () and [item.smoother for item in together.joint.estimates] == [
        item.smoother for item in found.joint.estimates
    ]
    single = [
        next(item for item in result.estimates if item.name == joint.name)
        for result in found.single
    ]
    assert standing(found)[0] == joint.name and found.findings[0].replicates
    assert joint.smoother.std < 0.7 * min(item.smoother.std for item in single)
    assert all(abs(item.smoother.value - 0.05) < 3.5 * item.smoother.std for item in single)
    biases = [result.biases[0].smoother.value for result in found.single]
    assert biases[1] - biases[0] == pytest.approx(0.1, abs=0.02)


@pytest.mark.slow
def test_a_fault_of_one_record_alone_does_not_replicate() -> None:
    records = [
        record(sensors=Sensors(delay={"alpha": 0.06}) if i == 0 else Sensors(), seed=i, name=str(i))
        for i in range(3)
    ]
    found = compatibility(records, SETTINGS)
    assert not [name for name in standing(found) if "alpha" in name or name == "vane-offset"]
    assert [finding.name for finding in found.findings if not finding.replicates]


def test_a_delay_of_all_channels_alike_is_invisible_and_said_to_be() -> None:
    found = compatibility(
        [record(sensors=Sensors(delay=dict.fromkeys(THREE, 0.08)), seed=4)], SETTINGS
    )
    assert standing(found) == []
    assert (
        "a delay common to alpha, q and nz is not observable, only relative delays are"
        in found.unobservable
    )
    assert (
        "a scale common to alpha, q and nz is not observable, only ratios are" in found.unobservable
    )


@pytest.mark.long
def test_theta_tells_the_biases_of_q_and_nz_apart() -> None:
    sensors = Sensors(bias={"q": 0.01, "nz": 0.05})
    found = compatibility([record(FOUR, sensors)], SETTINGS)
    values = {item.name: item for item in found.single[0].biases}
    assert values["bias:q"].smoother.value == pytest.approx(
        0.01, abs=4.0 * values["bias:q"].smoother.std
    )
    assert values["bias:nz"].smoother.value == pytest.approx(
        0.05, abs=4.0 * values["bias:nz"].smoother.std
    )
    assert not any("bias:nz and bias:q" in line for line in found.unobservable)
    assert any(
        "bias:nz and bias:q" in line for line in compatibility([record()], SETTINGS).unobservable
    )


def test_alpha_and_q_alone_tell_nothing_for_want_of_the_lift() -> None:
    found = compatibility([record(("alpha", "q"))], SETTINGS)
    assert found.relations == {} and found.findings == () and found.joint.estimates == ()
    assert any(
        line.startswith("alpha: cannot be checked") and "nz" in line and "lift" in line
        for line in found.unobservable
    )


def test_without_an_airspeed_the_relation_of_alpha_is_left_out() -> None:
    found = compatibility([record(FOUR)], CompatibilitySettings())
    assert set(found.relations) == {"theta"} and any("airspeed" in note for note in found.notes)


def test_az_serves_as_nz() -> None:
    plain = record(seed=5)
    nz = plain["nz"].values
    other = replace(
        plain, outputs=(plain["alpha"], plain["q"], Channel.of("az", "m/s2", -9.80665 * nz))
    )
    one, two = compatibility([plain], SETTINGS), compatibility([other], SETTINGS)
    for a, b in zip(one.joint.estimates, two.joint.estimates, strict=True):
        assert a.name == b.name and a.smoother.value == pytest.approx(
            b.smoother.value, rel=1e-6, abs=1e-9
        )


@pytest.mark.long
def test_a_clock_that_starts_elsewhere_changes_nothing() -> None:
    plain = record(sensors=Sensors(delay={"q": 0.05}), seed=6)
    later = replace(plain, time=plain.time + 1000.0)
    one, two = compatibility([plain], SETTINGS), compatibility([later], SETTINGS)
    for a, b in zip(one.joint.estimates, two.joint.estimates, strict=True):
        assert a.smoother.value == pytest.approx(b.smoother.value, abs=0.05 * a.smoother.std + 1e-9)


@pytest.mark.long
def test_spikes_and_gaps_do_no_harm() -> None:
    late = record(sensors=Sensors(delay={"alpha": 0.06}), seed=7)
    rng = np.random.default_rng(7)
    outputs = []
    for channel in late.outputs:
        values = np.where(rng.random(len(late)) < 0.05, np.nan, channel.values)
        values[180] += 30.0 * {"alpha": 0.0026, "q": 0.0026, "nz": 0.01}[channel.name]
        outputs.append(Channel.of(channel.name, channel.unit, values))
    found = compatibility([replace(late, outputs=tuple(outputs))], SETTINGS)
    item = next(item for item in found.joint.estimates if item.name == "sensor-delay:alpha")
    assert item.smoother.value == pytest.approx(0.06, abs=4.0 * item.smoother.std)
    assert sum("isolated wrong sample" in note for note in found.notes) >= 2


@pytest.mark.long
def test_reconstruction_follows_the_measurement_where_the_fault_is_taken_into_account() -> None:
    found = compatibility([record(sensors=Sensors(delay={"alpha": 0.06}))], SETTINGS)
    (one,) = found.reconstructions
    used = one.used["alpha"]
    assert float(np.std((one.measured["alpha"] - one.smoothed["alpha"])[used])) == pytest.approx(
        0.0026, rel=0.15
    )


def test_the_same_records_give_the_same_numbers() -> None:
    one, two = (compatibility([record(seed=8)], SETTINGS) for _ in range(2))
    assert one.joint == two.joint or one.joint.estimates == two.joint.estimates


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.window(0.0, 0.5), "too few"),
        (
            lambda r: replace(
                r,
                outputs=(
                    Channel.of("alpha", "rad", np.where(np.arange(len(r)) == 4, 1e9, 0.0)),
                    *r.outputs[1:],
                ),
            ),
            "no measurement",
        ),
        (
            lambda r: replace(
                r, outputs=(*r.outputs, Channel.of("airspeed", "m/s", np.zeros(len(r))))
            ),
            "not above zero",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(change: object, words: str) -> None:
    with pytest.raises(RecordError, match=words):
        compatibility([change(record())], SETTINGS)  # type: ignore[operator]


def test_a_channel_that_does_not_move_ends_well() -> None:
    still = record()
    flat = replace(
        still,
        outputs=tuple(Channel.of(c.name, c.unit, np.full(len(still), 0.01)) for c in still.outputs),
    )
    found = compatibility([flat], SETTINGS)
    assert standing(found) == []
    assert all(
        np.isfinite(
            [item.smoother.value, item.smoother.std, item.output_error.value, item.output_error.std]
        ).all()
        for item in found.joint.estimates
    )


@pytest.mark.long
def test_exact_data_end_well() -> None:
    found = compatibility([record(FOUR, noise=0.0)], SETTINGS)
    assert all(
        np.isfinite([item.smoother.value, item.smoother.std, item.gain]).all()
        for item in found.joint.estimates
    )


@pytest.mark.long
def test_a_gust_on_vane_and_load_is_not_laid_to_a_sensor() -> None:
    pattern = flights.three_two_one_one(0.06, 0.5, 1.0) + flights.doublet(-0.03, 1.0, 9.0)
    accused, noted = [], 0
    for seed in (0, 1, 2):
        rng = np.random.default_rng(seed)
        gust = flights.dryden(rng, 1.5, 150.0, flights.TRAINER.airspeed, 21.0)
        flown = flights.fly_aircraft(
            flights.TRAINER, flights.steps(pattern, 25.0, 20.0), 25.0, flights.Hidden(gust=gust)
        )
        columns = flights.measured(flown, rng, {name: NOISE[name] for name in THREE})
        outputs = tuple(Channel.of(name, UNITS[name], columns[name]) for name in THREE)
        found = compatibility(
            [Record(columns["time"], (), outputs)], CompatibilitySettings(flights.TRAINER.airspeed)
        )
        accused += standing(found)
        noted += any("a gust" in note for note in found.notes)
    assert accused == [] and noted > 0
