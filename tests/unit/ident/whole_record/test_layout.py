"""What a layout of several records holds, and the first guess of states that nobody measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.whole_record.layout import FitSettings, lay_out
from ident.whole_record.linearise import known_states
from sim.declaration.compile import compile_model
from sim.record import Channel, Record
from tests.bases import RIGID_VALUES, ballistic_model, rigid_model
from tests.rigid_problem import rigid_record


def test_initial_states_begin_at_the_first_samples_behind_each_records_biases() -> None:
    records = [rigid_record(np.random.default_rng(seed), 2.0) for seed in (1, 2)]
    layout = lay_out(
        records,
        compile_model(rigid_model(RIGID_VALUES).with_biases(("alpha", "q", "nz"))),
        FitSettings(),
    )
    start = dict(zip(layout.names, layout.start.tolist(), strict=True))
    for number, record in enumerate(records, start=1):
        assert start[f"alpha(0), record {number}"] == record["alpha"].values[0] != 0.0
        assert start[f"q(0), record {number}"] == record["q"].values[0] != 0.0
        assert [start[f"bias_{name}, record {number}"] for name in ("alpha", "q", "nz")] == [
            0.0,
            0.0,
            0.0,
        ]


@pytest.mark.parametrize("local", [(), ("Cm_q",)])
def test_each_record_sees_the_shared_unknowns_and_its_own(local: tuple[str, ...]) -> None:
    """By their names, and by what a change of each of them changes."""
    records = [rigid_record(np.random.default_rng(seed), 1.0) for seed in (1, 2, 3)]
    system = compile_model(rigid_model(RIGID_VALUES).with_biases(("alpha",)))
    layout = lay_out(records, system, FitSettings(), local=local)
    every = np.arange(1.0, len(layout.names) + 1.0)
    for r in range(3):
        seen = [layout.names[position] for position in layout.columns(r)]
        mine = [*layout.local, "alpha(0)", "q(0)"]
        assert seen == [*layout.shared, *(f"{name}, record {r + 1}" for name in mine)]
        p, x0 = layout.split(every, r)
        by_name = dict(zip(layout.names, every, strict=True))
        assert x0.tolist() == [by_name[f"{name}(0), record {r + 1}"] for name in ("alpha", "q")]
        for name in (*layout.shared, *layout.local):
            full = name if name in layout.shared else f"{name}, record {r + 1}"
            assert p[system.parameters.index(name)] == by_name[full]


def test_masks_set_samples_aside_and_bring_none_back() -> None:
    record = rigid_record(np.random.default_rng(3), 2.0)
    values = record["q"].values.copy()
    values[4] = np.nan
    holed = Record(
        record.time,
        record.inputs,
        tuple(Channel.of("q", "1", values) if c.name == "q" else c for c in record.outputs),
        record.hold,
    )
    mask = np.ones((3, len(record)), dtype=bool)
    mask[0, 10:20] = False
    layout = lay_out([holed], compile_model(rigid_model(RIGID_VALUES)), FitSettings(), masks=[mask])
    expected = mask.copy()
    expected[1, 4] = False
    np.testing.assert_array_equal(layout.problems[0].valid, expected)


def test_a_rate_that_is_not_measured_is_the_slope_of_lines_over_a_thirtieth_of_the_record() -> None:
    time = np.arange(600) * 0.05
    altitude = 60000.0 - 1800.0 * time + 40.0 * time**2 - 0.6 * time**3
    record = Record(time, (), (Channel.of("altitude", "m", altitude),))
    system = compile_model(ballistic_model())
    known = known_states(record, system)
    at, slope = known[system.state_names.index("velocity")]
    for k in (30, 300, 570):
        near = slice(k - 10, k + 11)
        assert slope[np.flatnonzero(at == time[k])[0]] == pytest.approx(
            np.polyfit(time[near], altitude[near], 1)[0], rel=1e-9
        )


def test_a_measured_state_is_guessed_less_the_bias_of_its_sensor() -> None:
    """Trim is among the biases: a motion that integrates the angle of attack would run away from a
    guess that holds it.
    """
    rng = np.random.default_rng(3)
    record = rigid_record(rng)
    shifted = replace(
        record,
        outputs=tuple(
            replace(c, values=c.values + 0.06) if c.name == "alpha" else c for c in record.outputs
        ),
    )
    system = compile_model(
        rigid_model().with_biases(["alpha", "q", "nz"]).with_values({"bias_alpha": 0.06})
    )
    at = system.state_names.index("alpha")
    assert known_states(shifted, system)[at][1] == pytest.approx(record["alpha"].values)
    p = system.parameters.values()
    p[system.parameters.index("bias_alpha")] = 0.01
    assert known_states(shifted, system, p)[at][1] == pytest.approx(record["alpha"].values + 0.05)
    layout = lay_out([shifted], system, FitSettings())
    assert layout.start[layout.names.index("alpha(0)")] == pytest.approx(record["alpha"].values[0])
