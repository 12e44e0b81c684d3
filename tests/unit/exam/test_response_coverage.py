"""Coverage of frequency responses: flights against second writings, counts, table, bad input."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from exam.coverage.frequency_responses import (
    AIRSPEED,
    BEGIN,
    END,
    GRAVITY,
    LAW,
    LOES,
    SHORT_PERIOD,
    STEP,
    bands,
    known_flight,
    loes_flight,
    main,
    statistics,
    table,
    true_margins,
)


def test_the_feedback_flight_is_its_loop() -> None:
    """Behind the known system what is left of the output is the noise, a third of its answer to
    the excitation."""
    joint, exact = known_flight("feedback", 1)
    direct, _ = known_flight("direct", 1)
    np.testing.assert_array_equal(joint.outputs, direct.outputs)
    assert len(direct.references) == 0 and exact.shape == (1, 60)
    command, output, excitation = joint.inputs[0], joint.outputs[0], joint.references[0]
    np.testing.assert_allclose(command, excitation - LAW * output, rtol=0, atol=1e-12)
    system = signal.cont2discrete(SHORT_PERIOD, STEP, "zoh")[:2]
    answer, alone = (
        signal.lfilter(np.ravel(system[0]), system[1], each) for each in (command, excitation)
    )
    assert np.std(output - answer) == pytest.approx(alone.std() / 3.0, rel=1e-6)


def test_a_low_order_flight_obeys_its_equations() -> None:
    """The differential equations by differences of a clean flight, away from the samples' noise."""
    frame = loes_flight(2, duration=20.0)
    assert list(frame.columns) == ["time [s]", "stick", "alpha [rad]", "q [rad/s]", "nz [g]"]
    time, alpha, q, nz = (frame[name].to_numpy() for name in frame.columns[[0, 2, 3, 4]])
    # nz = V/g (q - alpha_dot), integrated: the sum of nz follows q and alpha.
    step = time[1] - time[0]
    turned = np.cumsum(nz) * step * GRAVITY / AIRSPEED
    follows = np.cumsum(q) * step - (alpha - alpha[0])
    assert np.abs(turned - follows).max() < 0.05 * np.ptp(follows)
    # Steady gain of q over the stick at the lowest frequencies, from the equations at rest.
    A = np.array([[LOES["L_alpha"], LOES["L_q"]], [LOES["M_alpha"], LOES["M_q"]]])
    steady = np.linalg.solve(A, [-LOES["L_delta"], -LOES["M_delta"]])[1]
    size = np.std(q[:150]) / np.std(frame["stick"].to_numpy()[:150])
    assert 0.5 * steady < size < 2.0 * steady


@pytest.mark.long
def test_known_margins_lie_on_the_loop() -> None:
    exact = true_margins("F")
    # The distance from -1 bounds the others: 2 sin(phase/2), and the gain that reaches -1.
    least = exact["distance"]
    assert 2.0 * math.sin(math.radians(exact["phase_margin"]) / 2.0) >= least
    assert 1.0 - 10.0 ** (-exact["gain_increase"] / 20.0) >= least


def test_bands_are_counted() -> None:
    held = bands("two", 3)
    assert set(held) == {"magnitude", "phase", "circle"}
    assert all(count == 120 and 0.8 * count < inside <= count for inside, count in held.values())


def test_shares_and_their_table() -> None:
    rows = [{"case": "one", "run": n, "held": {"phase": [57 + n % 3, 60]}} for n in range(9)]
    runs, share, low, high = statistics(rows)["phase"]
    assert runs == 9 and share == pytest.approx(58 / 60) and low < share < high
    assert "| response, one input | 9 | phase | 96.7 %" in table(rows)


def test_what_a_file_holds_is_not_run_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, page = tmp_path / "rows.jsonl", tmp_path / "page.md"
    assert main([str(rows), "--runs", "2", "--only", "one"]) == 0
    written = rows.read_text(encoding="utf-8")
    assert [json.loads(line)["run"] for line in written.splitlines()] == [0, 1]
    page.write_text(f"before\n{BEGIN}\nstale\n{END}\nafter\n", encoding="utf-8")
    assert main([str(rows), "--runs", "2", "--only", "one", "--page", str(page)]) == 0
    assert rows.read_text(encoding="utf-8") == written
    text = page.read_text(encoding="utf-8")
    assert "| response, one input | 2 |" in text and "stale" not in text and "after" in text
    capsys.readouterr()
    page.write_text("no marks\n", encoding="utf-8")
    assert main([str(rows), "--runs", "0", "--page", str(page)]) == 2
    assert "has no marks" in capsys.readouterr().err
    assert main([str(rows), "--runs", "-1"]) == 2
    assert "give 0 or more" in capsys.readouterr().err
