"""One filter for all channels: what it does to sines by Butterworth's formula, that it leaves
derivatives alone, gaps, refusals.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.whole_record.output_error import fit_output_error
from scenarios.files.measured.grid import FILTER_ORDER
from scenarios.preparation.filtering import filtered
from scenarios.preparation.plan import Plan
from sim.declaration.compile import compile_model
from sim.errors import RecordError
from sim.record import Channel, Hold, Record
from tests.oracles.falling_speed import TRUE, fly_falling
from tests.preparing import declared, record_of


def sine(frequency: float, rate: float = 50.0, duration: float = 40.0) -> Record:
    time = np.arange(int(duration * rate)) / rate
    wave = np.sin(2.0 * np.pi * frequency * time)
    return Record(
        time,
        (Channel.of("elevator", "rad", wave),),
        (Channel.of("q", "rad/s", 2.0 * wave),),
        Hold.LINEAR,
    )


@settings(max_examples=15, deadline=None)
@given(frequency=st.floats(0.2, 6.0), corner=st.floats(1.0, 8.0))
def test_amplitude_is_butterworths_squared_and_phase_none(frequency: float, corner: float) -> None:
    record, said = filtered(sine(frequency), Plan(lowpass=corner))
    # Both ways, hence the square; the bilinear transform bends frequencies as the tangent does.
    bent = np.tan(np.pi * frequency / 50.0) / np.tan(np.pi * corner / 50.0)
    due = 1.0 / (1.0 + bent ** (2 * FILTER_ORDER))
    inside = slice(500, -500)
    wave = sine(frequency)["elevator"].values[inside]
    for name, size in (("elevator", 1.0), ("q", 2.0)):
        values = record[name].values[inside]
        assert values @ wave / (wave @ wave) == pytest.approx(size * due, abs=2e-3)
        assert np.max(np.abs(values - size * due * wave)) < 4e-3
    assert "low-pass" in said and record.hold is Hold.LINEAR


@pytest.mark.parametrize("rate", [10.0, 12.5])
def test_a_new_rate_has_its_corner_at_eight_tenths_of_half_of_it_so_that_nothing_folds_back(
    rate: float,
) -> None:
    def left(frequency: float, plan: Plan) -> float:
        record, _ = filtered(sine(frequency), plan)
        inside = record["q"].values[(record.time > 10.0) & (record.time < 30.0)]
        return float(np.sqrt(2.0 * np.mean(inside**2))) / 2.0

    corner = 0.5 * 0.8 * rate
    assert left(corner, Plan(rate=rate)) == pytest.approx(0.5, abs=0.02)
    assert left(0.25 * corner, Plan(rate=rate)) == pytest.approx(1.0, abs=0.01)
    # What would show as a frequency of the motion, a tenth of the new rate: by Butterworth's
    # formula.
    assert left(0.9 * rate, Plan(rate=rate)) < 2e-3
    # Of two corners the lower one acts.
    assert left(2.0, Plan(rate=rate, lowpass=2.0)) == pytest.approx(0.5, abs=0.01)
    assert left(corner, Plan(rate=rate, lowpass=2.0 * corner)) == pytest.approx(0.5, abs=0.02)


def test_without_a_filter_the_record_is_the_same_object() -> None:
    record = sine(1.0)
    assert filtered(record, Plan()) == (record, "")


def test_channels_filtered_alike_keep_delay_and_size_between_them() -> None:
    """Noise in, the same noise late and twice as large out: what the filter leaves still differs by
    just that.
    """
    rng, late = np.random.default_rng(0), 3
    noise = np.convolve(rng.standard_normal(2000), np.ones(5) / 5.0, mode="same")
    time = np.arange(1500) / 50.0
    inputs, outputs = (
        (Channel.of("elevator", "rad", noise[late : 1500 + late]),),
        (Channel.of("q", "rad/s", 2.0 * noise[:1500]),),
    )
    record, _ = filtered(Record(time, inputs, outputs, Hold.LINEAR), Plan(lowpass=4.0))
    u, q = record["elevator"].values, record["q"].values
    np.testing.assert_allclose(q[100:-100], 2.0 * u[100 - late : -100 - late], atol=2e-3)


@pytest.mark.parametrize(
    ("held", "plan"),
    [(False, Plan(lowpass=2.0)), (False, Plan(rate=12.5)), (True, Plan(lowpass=3.0))],
)
def test_derivatives_do_not_notice_the_filter(held: bool, plan: Plan) -> None:
    """It commutes with a linear model. Loads that follow a held input at once (CL_de, and CL_q with
    it) do notice.
    """
    flown = fly_falling(weight=False, fall=0.0, held=held)
    record, _ = filtered(record_of(flown, Hold.PREVIOUS if held else Hold.LINEAR), plan)
    estimate = fit_output_error(
        [record], compile_model(declared().with_biases(["alpha", "q", "nz"]), ["alpha", "q", "nz"])
    )
    limits = {"CL_alpha": 0.003, "Cm_alpha": 0.003, "Cm_q": 0.005, "Cm_de": 0.005} | (
        {} if held else {"CL_q": 0.05, "CL_de": 0.03}
    )
    for name, limit in limits.items():
        assert abs(estimate.value(name) / TRUE[name] - 1.0) < limit, name


def test_lines_through_the_new_samples_keep_what_a_coarse_input_had() -> None:
    """Samples of a sine joined by lines fall short of it by (omega T)^2/12; least squares does
    not.
    """
    record, _ = filtered(sine(1.0, duration=20.0), Plan(rate=8.0))
    fine = np.linspace(2.0, 18.0, 4001)
    lines = np.interp(fine, record.time, record["elevator"].values)
    wave = np.sin(2.0 * np.pi * fine)
    assert lines @ wave / (wave @ wave) == pytest.approx(1.0, abs=0.004)
    assert len(record) == 160 and np.allclose(np.diff(record.time), 0.125)


def test_samples_near_a_gap_are_missing_and_uneven_ones_are_laid_on_a_grid() -> None:
    record = sine(0.5, duration=10.0)
    values = record["q"].with_gaps().copy()
    values[200:210] = np.nan
    gapped = Record(record.time, record.inputs, (Channel.of("q", "rad/s", values),), Hold.LINEAR)
    out, _ = filtered(gapped, Plan(lowpass=5.0))
    lost = np.flatnonzero(~out["q"].valid)
    # half a period of the corner, 5 samples, to either side
    assert (lost[0], lost[-1]) == (195, 214)
    keep = np.ones(len(record), dtype=bool)
    keep[1:-1:2] = np.random.default_rng(1).random(len(keep[1:-1:2])) > 0.6
    uneven = Record(
        record.time[keep],
        (Channel.of("elevator", "rad", record["elevator"].values[keep]),),
        (Channel.of("q", "rad/s", record["q"].values[keep]),),
        Hold.LINEAR,
    )
    even, _ = filtered(uneven, Plan(lowpass=5.0))
    assert np.ptp(np.diff(even.time)) < 1e-9
    np.testing.assert_allclose(
        even["q"].values[50:-50], 2.0 * np.sin(np.pi * even.time[50:-50]), atol=0.02
    )


@pytest.mark.parametrize(
    ("plan", "parts"),
    [
        (Plan(rate=60.0), ("--rate 60 Hz is above the record's 50 Hz",)),
        (Plan(lowpass=25.0), ("--lowpass 25 Hz is not below half the record's 50 Hz",)),
        (Plan(lowpass=0.01), ("--lowpass 0.01 Hz leaves nothing of a record of",)),
    ],
)
def test_what_a_record_cannot_give_is_refused(plan: Plan, parts: tuple[str, ...]) -> None:
    with pytest.raises(RecordError) as told:
        filtered(sine(1.0), plan)
    assert all(part in str(told.value) for part in parts)
    with pytest.raises(RecordError, match="too few for a filter"):
        filtered(sine(1.0, duration=0.5), Plan(lowpass=4.0))
