"""Records that no fit should start from are refused in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.preparation.measured_inputs import with_attitude
from scenarios.preparation.plan import Plan
from scenarios.preparation.plausibility import moves, not_recorded, refuse_still, refuse_too_few
from scenarios.preparation.recording import checked_records, expectations_of
from sim.errors import RecordError
from sim.record import Channel, Record
from tests import bases
from tests.oracles.falling_speed import fly_falling
from tests.preparing import declared, record_of


@pytest.fixture(scope="module")
def sound() -> Record:
    return record_of(fly_falling(weight=False, fall=0.0), rng=np.random.default_rng(0))


def with_values(record: Record, name: str, values: np.ndarray) -> Record:
    def changed(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(Channel.of(c.name, c.unit, values) if c.name == name else c for c in channels)

    return replace(record, inputs=changed(record.inputs), outputs=changed(record.outputs))


def test_a_sound_record_passes(sound: Record) -> None:
    refuse_still([sound], declared())
    (same,), look = checked_records([sound], expectations_of(declared()), Plan())
    assert same is sound and look.seen == ()


def test_a_stuck_channel_is_named(sound: Record) -> None:
    stuck = with_values(sound, "q", np.full(len(sound), 0.1))
    with pytest.raises(RecordError, match="channel q: all samples are the same"):
        refuse_still([sound, stuck], declared())


def test_a_control_may_rest_in_some_records_but_not_in_all(sound: Record) -> None:
    resting = with_values(sound, "elevator", np.full(len(sound), 0.02))
    refuse_still([sound, resting], declared())
    with pytest.raises(RecordError, match="the elevator never moves"):
        refuse_still([resting, resting], declared())


def test_a_measured_attitude_is_no_control_that_moves(sound: Record) -> None:
    """Recorded with the motion, it moves beside an elevator that does not."""
    resting = with_values(sound, "elevator", np.full(len(sound), 0.02))
    attitude = Channel.of("theta", "rad", np.linspace(0.0, 0.2, len(sound)))
    model, (record,), said = with_attitude(
        declared(), [replace(resting, outputs=(*resting.outputs, attitude))]
    )
    assert said and record.input_names == ("elevator", "theta")
    with pytest.raises(RecordError, match="the elevator never moves"):
        refuse_still([record], model)


@given(st.integers(0, 10_000), st.integers(10, 3000), st.floats(1e-6, 1e6))
def test_noise_alone_is_no_motion_and_a_spike_is_none(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    values = size * (5.0 + rng.standard_normal(count))
    if count > 20:
        values[count // 2] += 50.0 * size
        assert not moves(Channel.of("q", "rad/s", values))
    assert moves(Channel.of("q", "rad/s", values + 20.0 * size * (np.arange(count) > 0.6 * count)))


@pytest.mark.parametrize("name", ["alpha", "elevator"])
def test_degrees_in_a_column_of_radians_are_noticed(sound: Record, name: str) -> None:
    degrees = np.degrees(sound[name].values)
    with pytest.raises(RecordError, match=f"channel {name}: moves by .*{name}_deg"):
        checked_records([with_values(sound, name, degrees)], expectations_of(declared()), Plan())


def test_single_wild_samples_are_left_to_the_search_for_spikes(sound: Record) -> None:
    wild = sound["alpha"].values.copy()
    wild[:3] = 50.0
    (_,), look = checked_records(
        [with_values(sound, "alpha", wild)], expectations_of(declared()), Plan()
    )
    assert all(one.finding.kind.value == "dropout" for one in look.seen)


def test_fewer_samples_than_unknowns_are_refused(sound: Record) -> None:
    model = bases.rigid_model()
    refuse_too_few([sound], model)
    first, last = float(sound.time[100]), float(sound.time[101])
    with pytest.raises(RecordError, match="2 rows with 6 samples of outputs are too few for 11"):
        refuse_too_few([sound.window(first, last)], model)


def test_outputs_that_a_predicted_record_lacks_are_named_and_those_it_has_are_not(
    sound: Record,
) -> None:
    fewer = replace(sound, outputs=sound.outputs[:1])
    outputs = sound.output_names
    (note,) = not_recorded(outputs, [sound, fewer])
    assert note.startswith(f"{fewer.name}: {', '.join(outputs[1:])} ")
    assert not_recorded(outputs, [sound]) == ()
