"""`flightid watch`: a file that grows, a pipe, broken lines, an end at any place; the same estimate
as a batch run of the same rows.
"""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from ident.banks.bank import run_bank
from ident.banks.delays import DELAYS
from ident.banks.online import bank_estimate
from ident.frequency_domain.online import frequencies
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.files.vehicles import VehicleFile
from scenarios.files.writing import write_record
from scenarios.identification.low_order import less
from scenarios.watching import spectral
from scenarios.watching.reference import (
    Reference,
    View,
    comparisons,
    live_table,
    read_reference,
    vehicle_to_watch,
)
from scenarios.watching.session import ROWS_PER_BATCH, Session, pieces, record_of, start, take
from scenarios.watching.spectral import spectral_session
from scenarios.watching.study import first_pass_so_far, likely_estimate, so_far
from sim.record import Record
from tests import bases
from tests import loes_problem as problem
from tests.bases import LOES_CONSTANTS, LOES_VALUES
from tests.integration.command_line import CommandLine, contents
from tests.rigid_problem import noisy

ROOT = Path(__file__).parents[3]
START = {**{name: 1.15 * value for name, value in LOES_VALUES.items()}, "L_q": 1.0, "delay": 0.05}
WRITTEN = {
    "comparison.json",
    "frequency.csv",
    "history.csv",
    "record.csv",
    "record.json",
    "report.html",
    "report.json",
    "study.txt",
    "watched.png",
}
PARAMETERS = {
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "L_0",
    "M_0",
    "delta_0",
    "nz_0",
}


@pytest.fixture(scope="module")
def flown() -> Record:
    return problem.record(11, duration=6.0, gaps=True)


@pytest.fixture(scope="module")
def folder(flown: Record, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`flight.csv` and `vehicle.toml`; tests only read them."""
    made = tmp_path_factory.mktemp("stream")
    write_record(made, flown, "flight")
    lines = [
        'name = "demonstrator"',
        *(f"{name} = {value}" for name, value in LOES_CONSTANTS.items()),
        "[derivatives]",
    ]
    (made / "vehicle.toml").write_text(
        "\n".join([*lines, *(f"{name} = {value}" for name, value in START.items())]) + "\n"
    )
    return made


@pytest.fixture(scope="module")
def options(folder: Path) -> list[str]:
    return ["--model", "loes", "--vehicle", str(folder / "vehicle.toml")]


def comparison(out: Path) -> dict[str, Any]:
    return json.loads((out / "comparison.json").read_text(), parse_constant=pytest.fail)


def history(out: Path) -> tuple[list[str], np.ndarray]:
    header, *rows = csv.reader((out / "history.csv").read_text().splitlines())
    return header, np.array([[float(cell or "nan") for cell in row] for row in rows])


@contextmanager
def process(*arguments: object, stdin: int | None = None) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "scenarios", "watch", *(str(each) for each in arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": stdin}
    with subprocess.Popen(command, text=True, env=environment, **pipes) as running:  # type: ignore[call-overload]
        try:
            yield running
        finally:
            running.kill()


def until(condition: Any) -> None:
    ends = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < ends, "it did not come"
        time.sleep(0.05)


def vehicle_file() -> VehicleFile:
    return VehicleFile("demonstrator", "loes", LOES_CONSTANTS, START)


def table_of(record: Record) -> np.ndarray:
    return np.vstack([record.time, *(channel.with_gaps() for channel in record.channels)])


@pytest.mark.long
def test_watch_finds_what_identify_finds(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path
) -> None:
    printed = flightid.done(
        "watch", folder / "flight.csv", *options, "--until-end", "--out", tmp_path / "watched"
    )
    flightid.done(
        "identify",
        folder / "flight.csv",
        *options,
        "--method",
        "ekf",
        "--no-figures",
        "--out",
        tmp_path / "identified",
    )
    watched, identified = comparison(tmp_path / "watched"), comparison(tmp_path / "identified")
    for key in ("parameters", "derived", "fixed", "outcome", "noise_std", "correlation"):
        assert watched[key] == identified[key], key
    assert (
        set(watched["parameters"]) == {*PARAMETERS, "delay"} and watched["outcome"] == "converged"
    )
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"):
        row = watched["parameters"][name]
        assert abs(row["estimate"] - LOES_VALUES[name]) < 4.0 * row["std"], name
    assert {*watched["files"], "study.txt"} == set(contents(tmp_path / "watched")) == WRITTEN
    assert (tmp_path / "watched" / "record.csv").read_bytes() == (
        folder / "flight.csv"
    ).read_bytes()
    assert watched["stream"] == {
        "rows": 151,
        "left_out": 0,
        "mended": 0,
        "spikes": 0,
        "trim": {},
        "ended": "the stream ended",
    }
    header, rows = history(tmp_path / "watched")
    for name in ("M_q", "delay"):  # on the way it comes to the same
        on_the_way, row = rows[:, header.index(f"refined_{name}")], watched["parameters"][name]
        assert np.isnan(on_the_way[0]) and abs(on_the_way[-1] - row["estimate"]) < 0.5 * row["std"]
    told = [line for line in printed.splitlines() if "most likely" in line]
    assert [line.split(", ")[1] for line in told] == [
        "2.96 s",
        "3.96 s",
        "4.96 s",
        "5.96 s",
        "6.00 s",
    ]


@pytest.mark.long
def test_history_ends_at_the_online_estimate(
    flightid: CommandLine, flown: Record, folder: Path, options: list[str], tmp_path: Path
) -> None:
    flightid.done(
        "watch",
        folder / "flight.csv",
        *options,
        "--until-end",
        "--no-refine",
        "--out",
        tmp_path / "out",
    )
    content, (header, rows) = comparison(tmp_path / "out"), history(tmp_path / "out")
    assert content["method"] == "online" and set(content["methods"]) == {"frequency-domain"}
    assert "refined" not in content["bank"]
    last = dict(zip(header, rows[-1], strict=True))
    for name in PARAMETERS:
        assert last[name] == pytest.approx(content["parameters"][name]["estimate"], rel=1e-8)
        assert np.hypot(last[f"{name}_std"], last[f"{name}_spread"]) == pytest.approx(
            content["parameters"][name]["std"], rel=1e-8
        )
    assert (
        last["most_likely_delay"]
        == content["fixed"]["delay"]["value"]
        == content["bank"]["most_likely"]
    )
    assert last["weighted_delay"] == pytest.approx(
        content["derived"]["delay"]["estimate"], rel=1e-8
    )
    np.testing.assert_array_equal(rows[:, 0], flown.time)
    np.testing.assert_array_equal(
        np.isnan(rows[:, header.index("innovation_q")]), ~flown["q"].valid
    )
    np.testing.assert_allclose(
        rows[:, [i for i, name in enumerate(header) if name.startswith("weight_")]].sum(axis=1),
        1.0,
        rtol=1e-8,
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_the_last_state_is_the_batch_bank_of_the_same_rows(flown: Record, seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = table_of(flown)[:, rng.random(len(flown)) > 0.1]
    table[2, 70], table[4, 90] = 1e5, -700.0
    table[1:4] += np.array([[0.4], [0.05], [0.1]])  # not about the trim
    session = Session(vehicle_file(), "stream", "in")
    for block in np.split(
        table, np.sort(rng.choice(np.arange(1, table.shape[1]), 9, replace=False)), axis=1
    ):
        take(session, block)
    assert start(session) == [] and session.system is not None and session.spikes == 2
    assert session.offsets == pytest.approx({"stick": 0.4, "alpha": 0.05, "q": 0.1}, abs=2e-3)
    kept = record_of(session)
    assert not kept["alpha"].valid[70] and not kept["nz"].valid[90] and len(kept) == table.shape[1]
    # What the filter was given: about the trim.
    expected = run_bank(
        less(record_of(session), session.offsets),
        session.system,
        fixed_values={"delay": np.array(DELAYS)},
    )
    assert session.bank is not None and session.state is not None
    found = bank_estimate(session.bank, session.state)
    np.testing.assert_allclose((found.mean - expected.mean) / expected.std, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, rtol=1e-9)
    for name in ("L_alpha", "M_alpha", "M_q"):
        row = found.names.index(name)
        assert abs(found.mean[row, 5] - LOES_VALUES[name]) < 5.0 * found.std[row, 5], name


def test_what_is_shown_does_not_hang_on_how_rows_came() -> None:
    session = Session(vehicle_file(), "stream", "in")
    table = np.vstack([np.arange(1200) / 40.0, *np.zeros((4, 1200))])
    assert list(pieces(None, np.zeros((0, 0)))) == []
    before = [piece.shape[1] for piece in pieces(session, table)]
    assert before == [40] * 30
    take(session, table_of(problem.record(11, duration=3.0)))
    together = list(pieces(session, table))
    np.testing.assert_array_equal(np.hstack(together), table)
    assert max(piece.shape[1] for piece in together) == ROWS_PER_BATCH and all(
        piece[0, 0] == np.floor(piece[0, 0]) for piece in together
    )
    # a second of many rows stays whole
    assert [piece.shape[1] for piece in pieces(session, table / 100.0)] == [1200]


@pytest.mark.long
def test_a_file_that_grows(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path
) -> None:
    text = (folder / "flight.csv").read_text()
    flightid.done(
        "watch",
        folder / "flight.csv",
        *options,
        "--until-end",
        "--no-refine",
        "--out",
        tmp_path / "whole",
    )
    growing, out = tmp_path / "growing.csv", tmp_path / "out"
    cuts = [0, 12, len(text) // 2 + 3, len(text) // 2 + 4, len(text) - 5, len(text)]
    growing.write_text("")
    with process(growing, *options, "--no-refine", "--idle", "60", "--out", out) as running:
        for number, (first, last) in enumerate(pairwise(cuts)):
            with growing.open("a") as file:
                file.write(text[first:last])
            if number == 2:
                until(
                    lambda: (
                        (out / "history.csv.part").is_file()
                        and (out / "history.csv.part").read_text().count("\n") > 60
                    )
                )
                assert (out / "history.csv.part").read_text().endswith("\n") and not (
                    out / "comparison.json"
                ).exists()
            time.sleep(0.15)
        until(lambda: (out / "history.csv.part").read_text().count("\n") == 152)
        growing.write_text("")  # a file that is cut short has ended
        printed, errors = running.communicate(timeout=60)
    assert (running.returncode, errors) == (0, "")
    assert "151 rows" in printed and set(contents(out)) == WRITTEN
    assert (out / "record.csv").read_bytes() == (tmp_path / "whole" / "record.csv").read_bytes()
    np.testing.assert_allclose(
        history(out)[1], history(tmp_path / "whole")[1], rtol=1e-7, atol=1e-9
    )


@pytest.mark.long
def test_a_pipe_with_broken_lines(folder: Path, options: list[str], tmp_path: Path) -> None:
    header, *lines = (folder / "flight.csv").read_text().splitlines()
    cells = lines[80].split(",")
    spiked = ",".join([*cells[:2], "1e6", *cells[3:]])
    held = ",".join([lines[81].split(",")[0], "", *lines[81].split(",")[2:]])
    after = [*lines[82:120], *lines[125:]]  # five rows are lost
    broken = [
        header,
        *lines[:30],
        "noise on the line",
        lines[12],
        *lines[30:80],
        spiked,
        held,
        *after,
        "6.04,0.1,0.0",
    ]
    with process(
        "-", *options, "--no-refine", "--out", tmp_path / "out", stdin=subprocess.PIPE
    ) as running:
        printed, errors = running.communicate("\n".join(broken), timeout=60)
    assert running.returncode == 0
    assert [line.split(":")[1].strip() for line in errors.splitlines()] == [
        "standard input, row 32",
        "standard input, row 85",
    ]
    stream = comparison(tmp_path / "out")["stream"]
    assert (stream["rows"], stream["left_out"], stream["mended"], stream["spikes"]) == (
        146,
        3,
        1,
        1,
    )
    assert "146 rows, 3 lines left out, 1 spike left out" in " ".join(printed.split())
    parameters = comparison(tmp_path / "out")["parameters"]
    for name in ("L_alpha", "M_alpha", "M_q"):
        assert (
            abs(parameters[name]["estimate"] - LOES_VALUES[name]) < 5.0 * parameters[name]["std"]
        ), name


@pytest.mark.long
def test_ctrl_c_ends_it_whole_and_its_page(
    folder: Path, options: list[str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with process(
        folder / "flight.csv", *options, "--page", "--idle", "60", "--out", out
    ) as running:
        assert running.stderr is not None
        address = running.stderr.readline().split()[-1]
        until(
            lambda: (
                (out / "history.csv.part").is_file()
                and (out / "history.csv.part").read_text().count("\n") == 152
            )
        )
        with urlopen(address, timeout=60) as answer:
            assert "EventSource" in answer.read().decode()
        running.send_signal(signal.SIGINT)
        printed, errors = running.communicate(timeout=60)
    assert (running.returncode, errors) == (
        0,
        "",
    ) and "stopped by the user; refined on line" in printed
    assert (
        comparison(out)["stream"]["ended"] == "stopped by the user" and len(history(out)[1]) == 151
    )
    assert set(contents(out)) == WRITTEN


@pytest.mark.long
def test_reference_gives_the_start_and_the_bounds(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path
) -> None:
    flightid.done(
        "identify",
        folder / "flight.csv",
        *options,
        "--method",
        "ekf",
        "--no-figures",
        "--out",
        tmp_path / "study",
    )
    content = comparison(tmp_path / "study")
    shifted = content["parameters"]["M_q"]["estimate"]
    content["parameters"]["M_q"]["estimate"] = shifted - 6.0 * content["parameters"]["M_q"]["std"]
    (tmp_path / "study" / "comparison.json").write_text(json.dumps(content))
    printed = flightid.done(
        "watch",
        folder / "flight.csv",
        "--model",
        "loes",
        "--reference",
        tmp_path / "study",
        "--until-end",
        "--no-refine",
        "--out",
        tmp_path / "out",
    )
    assert f" more than two sigmas from {tmp_path / 'study'}: " in printed
    told = comparison(tmp_path / "out")["reference"]
    assert "M_q" in told["outside"] and "L_q" not in told["outside"] and told["study"] == "study"
    by_name = {row["name"]: row for row in told["differences"]}
    assert {"natural_frequency", "damping_ratio", "delay", *PARAMETERS} == set(by_name)
    assert by_name["M_q"]["sigmas"] > 2.0 and by_name["M_q"]["outside"]
    begun = vehicle_to_watch(None, read_reference(tmp_path / "study"))
    assert (
        begun.constants == LOES_CONSTANTS
        and begun.derivatives["L_alpha"] == content["parameters"]["L_alpha"]["estimate"]
    )


def test_flags_take_both_uncertainties(flown: Record) -> None:
    session = Session(vehicle_file(), "stream", "in")
    take(session, table_of(flown))
    found = first_pass_so_far(session)
    estimate, weights = found.estimate, found.weights
    assert session.bank is not None
    at, sigma = estimate.value("M_q"), estimate.sigma("M_q")
    other, spread = estimate.value("M_alpha"), estimate.sigma("M_alpha")
    reference = Reference(
        "study", {"M_q": (at + 2.5 * sigma, sigma), "M_alpha": (other + 2.5 * spread, 0.1 * spread)}
    )
    items = {item.name: item for item in comparisons(estimate, found.derived, reference)}
    assert items["M_q"].z == pytest.approx(-2.5 / 2**0.5) and not items["M_q"].beyond
    assert items["M_alpha"].z == pytest.approx(-2.5 / 1.01**0.5) and items["M_alpha"].beyond
    assert items["L_q"].z is None and not items["L_q"].beyond
    drawn = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    drawn.print(
        live_table(
            View(
                "stream",
                6.0,
                151,
                2,
                0,
                tuple(items.values()),
                session.bank.delays,
                weights,
                silent=3.2,
            )
        )
    )
    lines = drawn.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert "stream, 6.00 s, 151 rows, 2 lines left out, nothing new for 3 s" in " ".join(
        " ".join(lines[:3]).split()
    )
    assert ["outside" in line for line in lines if "M_alpha" in line or "M_q" in line] == [
        True,
        False,
    ]
    assert "…" not in drawn.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.long
def test_what_another_start_would_not_have_found_is_no_number() -> None:
    """Of a start that is 60 % off the plain bank says nothing, where it would have been sure of
    numbers that are wrong.
    """
    far = replace(
        vehicle_file(),
        derivatives={name: 1.6 * value for name, value in LOES_VALUES.items()}
        | {"L_q": 1.0, "delay": 0.05},
    )
    session = Session(far, "stream", "in", refine=True)
    take(session, table_of(problem.record(3, duration=6.0)))
    assert session.bank is not None and session.state is not None
    alone, plain, refined = (
        likely_estimate(session.bank, session.state)[0],
        first_pass_so_far(session),
        so_far(session),
    )
    wrong = {
        name
        for name in ("M_alpha", "M_q", "inv_tau")
        if abs(alone.value(name) - LOES_VALUES[name]) > 4.0 * alone.sigma(name)
    }
    assert wrong
    for name in wrong:
        assert name in plain.hanging or abs(
            plain.estimate.value(name) - LOES_VALUES[name]
        ) < 3.0 * plain.estimate.sigma(name), name
        assert refined.refined and abs(
            refined.estimate.value(name) - LOES_VALUES[name]
        ) < 3.0 * refined.estimate.sigma(name), name
    items = comparisons(
        plain.estimate, plain.derived, Reference("study", {"M_q": (-3.0, 0.1)}), {"M_q"}
    )
    drawn = Console(file=io.StringIO(), width=100, force_terminal=True, color_system=None)
    drawn.print(
        live_table(View("stream", 6.0, 151, 0, 0, items, session.bank.delays, plain.weights))
    )
    (told,) = [line for line in drawn.file.getvalue().splitlines() if "M_q" in line]  # type: ignore[attr-defined]
    assert "depends on start" in told and told.split()[2:4] == ["-", "-"]


def test_without_vehicle_and_reference_it_starts_as_the_paper_did() -> None:
    begun = vehicle_to_watch(None, None)
    assert begun.derivatives["M_alpha"] == -14.0 and set(begun.constants) == {
        "airspeed",
        "gravity",
        "vane_arm",
    }


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "the stream is empty"),
        ("time,stick,alpha\n", "0 row(s) that can be used"),
        ("time,stick,alpha\n0,0,0\n", "1 row(s) that can be used"),
        ("time,alpha\n0,0\n", "there is no column 'stick'"),
        ("time,stick,alpha [kg]\n0,0,0\n", "does not measure an angle"),
        ("time,stick,alpha\n0,0,\n1,0,\n2,0,\n", "no number in any output"),
    ],
)
def test_streams_that_are_refused(
    flightid: CommandLine, options: list[str], tmp_path: Path, text: str, word: str
) -> None:
    (tmp_path / "bad.csv").write_text(text)
    assert word in flightid.refused(
        "watch", tmp_path / "bad.csv", *options, "--until-end", "--out", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_calls_that_are_refused(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path
) -> None:
    record = folder / "flight.csv"
    assert "there is no model 'rigit'" in flightid.refused("watch", record, "--model", "rigit")
    assert "needs constants and starting values" in flightid.refused(
        "watch", record, "--model", "rigid"
    )
    assert "2 to 1 Hz is no band" in flightid.refused("watch", record, *options, "--band", "2", "1")
    assert "there is no page of the model rigid" in flightid.refused(
        "watch", record, "--model", "rigid", "--page"
    )
    assert "there is no page to serve" in flightid.refused(
        "watch", record, *options, "--port", "8041"
    )
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert f"port {port} cannot be had" in flightid.refused(
            "watch", record, *options, "--page", "--port", port
        )
    assert "there is no such file" in flightid.refused("watch", tmp_path / "none.csv", *options)
    assert "this is a folder" in flightid.refused("watch", tmp_path, *options)
    (tmp_path / "flight.parquet").write_bytes(b"PAR1")
    assert "arrives line by line" in flightid.refused(
        "watch", tmp_path / "flight.parquet", *options
    )
    assert "comparison.json: there is no such file" in flightid.refused(
        "watch", record, "--model", "loes", "--reference", tmp_path
    )
    (tmp_path / "comparison.json").write_text(
        '{"schema": "flightid/comparison/1", "parameters": {"beta": {"estimate": 1.0, "std": 0.1}}}'
    )
    assert "there is no L_alpha in it" in flightid.refused(
        "watch", record, "--model", "loes", "--reference", tmp_path
    )
    (tmp_path / "comparison.json").write_text(
        '{"schema": "flightid/comparison/1", "parameters": {}, "start_dependent": ["L_alpha"]}'
    )
    assert "L_alpha hangs on the start in it" in flightid.refused(
        "watch", record, "--model", "loes", "--reference", tmp_path
    )
    (tmp_path / "record.csv").write_bytes(record.read_bytes())
    assert "would take the place" in flightid.refused(
        "watch", tmp_path / "record.csv", *options, "--until-end", "--out", tmp_path
    )
    (tmp_path / "record.json").write_text('{"schema": "flightid/record/1", "hold": "linear"}')
    assert "linear between samples" in flightid.refused("watch", tmp_path / "record.csv", *options)


@pytest.mark.sampled
@pytest.mark.parametrize("method", ["output-error", "filter-error"])
def test_identify_knows_the_low_order_equivalent_system(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path, method: str
) -> None:
    flightid.done(
        "identify",
        folder / "flight.csv",
        *options,
        "--method",
        method,
        "--no-figures",
        "--out",
        tmp_path,
    )
    content = comparison(tmp_path)
    assert set(content["derived"]) == {"natural_frequency", "damping_ratio", "delay"}
    row = content["parameters"]["delay"]
    assert abs(row["estimate"] - problem.TRUE_DELAY) < 4.0 * row["std"]
    assert "use ekf" in flightid.refused(
        "identify", folder / "flight.csv", *options, "--method", "ukf"
    )


# In the frequency domain ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Records and vehicle files of the rigid, the lateral and a user's own model, starts a fifth
    off.
    """
    made = tmp_path_factory.mktemp("measured")
    for name, values, model, flight in (
        ("rigid", bases.RIGID_VALUES, bases.rigid_model(), bases.rigid_flight(10.0)),
        ("lateral", bases.LATERAL_VALUES, bases.lateral_model(), bases.lateral_flight(10.0, 50.0)),
        (
            "longitudinal",
            bases.LONGITUDINAL_VALUES,
            bases.longitudinal_model(),
            bases.longitudinal_flight(12.0, 50.0),
        ),
    ):
        record = noisy(model, flight, np.random.default_rng(3))
        outputs = tuple(replace(each, unit=CHANNEL_UNITS[each.name]) for each in record.outputs)
        inputs = tuple(replace(each, unit=CHANNEL_UNITS[each.name]) for each in record.inputs)
        record = replace(record, inputs=inputs, outputs=outputs)
        write_record(made, record, name)
        free = model.parameters.free_names
        lines = [
            f'name = "{name}"',
            *(f"{key} = {value}" for key, value in values.items() if key not in free),
        ]
        lines += ["[derivatives]", *(f"{key} = {1.2 * values[key]}" for key in free)]
        (made / f"{name}.toml").write_text("\n".join(lines))
    return made


@pytest.mark.sampled
@pytest.mark.parametrize("model", ["rigid", "lateral", "longitudinal"])
def test_a_stream_of_measured_states(
    flightid: CommandLine, measured: Path, tmp_path: Path, model: str
) -> None:
    words = (
        "watch",
        measured / f"{model}.csv",
        "--model",
        model,
        "--vehicle",
        measured / f"{model}.toml",
        "--until-end",
    )
    printed = flightid.done(*words, "--out", tmp_path / "out")
    assert "equation error in the frequency domain" in printed and " s: " in printed
    assert f"constants and starting values: {model} ({model}.toml)" in printed
    page = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    uses = [(use, name) for use, name, _ in page["reproduction"]["inputs"]]
    assert uses == [("rows", f"{model}.csv"), ("vehicle", f"{model}.toml")]
    assert {path.name for path in (tmp_path / "out").iterdir()} == WRITTEN - {"frequency.csv"}
    content = comparison(tmp_path / "out")
    true = {
        "rigid": bases.RIGID_VALUES,
        "lateral": bases.LATERAL_VALUES,
        "longitudinal": bases.LONGITUDINAL_VALUES,
    }[model]
    errors = {
        name: (each["estimate"] - true[name]) / each["std"]
        for name, each in content["parameters"].items()
    }
    assert len(errors) >= 6 and np.mean(np.abs(list(errors.values())) < 2.5) >= 0.8, errors
    with (tmp_path / "out" / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    name, last = next(iter(content["parameters"].items()))
    assert float(rows[-1][name]) == pytest.approx(last["estimate"], rel=1e-8)
    assert float(rows[-1][f"{name}_std"]) == pytest.approx(last["std"], rel=1e-8)
    assert content["method"] == "frequency-domain" and content["band_Hz"] == pytest.approx(
        [0.1, 2.0]
    )


def test_no_figures(flightid: CommandLine, measured: Path, tmp_path: Path) -> None:
    words = ("--model", "rigid", "--vehicle", measured / "rigid.toml", "--until-end")
    out = tmp_path / "out"
    flightid.done("watch", measured / "rigid.csv", *words, "--no-figures", "--out", out)
    assert {path.name for path in out.iterdir()} == WRITTEN - {"frequency.csv", "watched.png"}
    assert "<figure" not in (out / "report.html").read_text(encoding="utf-8")


def test_how_rows_come_does_not_matter() -> None:
    """One row at a time, all at once: the same estimates, bit for bit."""
    record = noisy(bases.rigid_model(), bases.rigid_flight(6.0), np.random.default_rng(4))
    values = bases.RIGID_VALUES
    free = bases.rigid_model().parameters.free_names
    constants = {name: value for name, value in values.items() if name not in free}
    vehicle = VehicleFile("rigid", "rigid", constants, {name: values[name] for name in free})
    table = np.concatenate(
        [
            record.time[None],
            record.input_array(("elevator",)),
            record.output_array(("alpha", "q", "nz"))[0],
        ]
    )
    found = []
    for cuts in (range(1, table.shape[1]), [33, 34, 190], []):
        session = spectral_session(vehicle, "stream", ("alpha", "q", "nz"), frequencies())
        points = [
            point
            for part in np.split(table, list(cuts), axis=1)
            for point in spectral.take(session, part)
        ]
        found.append([*points, *spectral.regress(session)])
    for other in found[1:]:
        assert len(other) == len(found[0]) >= 5
        for one, two in zip(found[0], other, strict=True):
            assert one.time == two.time
            np.testing.assert_array_equal(one.values, two.values)


@pytest.mark.long
def test_the_bank_and_the_frequency_domain_agree(
    flightid: CommandLine, folder: Path, options: list[str], tmp_path: Path
) -> None:
    printed = flightid.done(
        "watch", folder / "flight.csv", *options, "--until-end", "--out", tmp_path / "out"
    )
    assert "in the frequency domain (difference from these" in " ".join(printed.split())
    content = comparison(tmp_path / "out")
    other = content["methods"]["frequency-domain"]
    assert set(LOES_VALUES) == set(other["parameters"])
    both = [name for name in other["parameters"] if name in content["parameters"]]
    apart = [
        (other["parameters"][name]["estimate"] - content["parameters"][name]["estimate"])
        / max(other["parameters"][name]["std"], content["parameters"][name]["std"])
        for name in both
    ]
    assert len(both) >= 6 and max(map(abs, apart)) < 3.0, dict(zip(both, apart, strict=True))
    errors = [
        (each["estimate"] - LOES_VALUES[name]) / each["std"]
        for name, each in other["parameters"].items()
        if name != "delay"
    ]
    assert np.mean(np.abs(errors) < 2.5) >= 0.8


def test_a_users_model_on_line_and_what_cannot_be(
    flightid: CommandLine, measured: Path, tmp_path: Path
) -> None:
    text = """
from sim.declaration import own_model

MODEL = own_model(
    name="pitch",
    states={"q": "rad/s"},
    inputs={"elevator": "rad"},
    outputs={"q": "rad/s"},
    parameters={"M_q": (-2.0, "1/s"), "M_de": (-8.0, "1/s2")},
    rates=lambda s, p: {"q": p.M_q * s.q + p.M_de * s.elevator},
    readings=lambda s, p: {"q": s.q},
)
"""
    own = tmp_path / "pitch.py"
    own.write_text(text)
    printed = flightid.done("watch", measured / "rigid.csv", "--model", own, "--until-end")
    assert "M_de" in printed
    bent = tmp_path / "bent.py"
    bent.write_text(text.replace("p.M_q * s.q", "p.M_q * p.M_q * s.q"))
    assert "not linear in M_q" in flightid.refused(
        "watch", measured / "rigid.csv", "--model", bent, "--until-end", "--out", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()
    hidden = tmp_path / "hidden.py"
    hidden.write_text(
        text.replace('states={"q"', 'states={"w": "rad/s", "q"').replace(
            '{"q": p.M_q', '{"w": -s.w, "q": s.w + p.M_q'
        )
    )
    assert "state w is not measured" in flightid.refused(
        "watch", measured / "rigid.csv", "--model", hidden, "--until-end"
    )


def test_a_reference_of_the_same_model(
    flightid: CommandLine, measured: Path, tmp_path: Path
) -> None:
    words = (measured / "rigid.csv", "--model", "rigid", "--vehicle", measured / "rigid.toml")
    flightid.done("identify", *words, "--no-figures", "--out", tmp_path / "study")
    printed = flightid.done(
        "watch", *words, "--until-end", "--reference", tmp_path / "study", "--out", tmp_path / "out"
    )
    assert "off, sigmas" in printed and "compared quantities agree with" in printed
    assert comparison(tmp_path / "out")["reference"]["differences"]


def test_derivatives_that_contradict_the_vehicle_file_are_warned_of(
    flightid: CommandLine, measured: Path, tmp_path: Path
) -> None:
    table = pd.read_csv(measured / "rigid.csv")
    name = next(each for each in table.columns if each.startswith("alpha"))
    table[name] = table[name].shift(15, fill_value=table[name].iloc[0])
    table.to_csv(tmp_path / "late.csv", index=False, sep=";", decimal=",")
    (tmp_path / "late.json").write_text((measured / "rigid.json").read_text())
    words = ("--model", "rigid", "--vehicle", measured / "rigid.toml")
    printed = flightid.done(
        "watch", tmp_path / "late.csv", *words, "--until-end", "--out", tmp_path / "out"
    )
    assert "warning: implausible: CL_" in printed
    assert comparison(tmp_path / "out")["warnings"][0].startswith("implausible: CL_")
    page = json.loads((tmp_path / "out" / "report.json").read_text())
    assert page["tone"] == "fair"


def test_a_stream_that_is_too_short_has_no_number(
    flightid: CommandLine, measured: Path, tmp_path: Path
) -> None:
    rows = (measured / "rigid.csv").read_text().splitlines()[:20]
    (tmp_path / "short.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "short.json").write_text((measured / "rigid.json").read_text())
    words = (
        "watch",
        tmp_path / "short.csv",
        "--model",
        "rigid",
        "--vehicle",
        measured / "rigid.toml",
        "--until-end",
    )
    printed = flightid.done(*words, "--out", tmp_path / "out")
    assert "not determined by this stream: CL_alpha" in printed
    content = comparison(tmp_path / "out")
    assert (
        content["parameters"] == {}
        and content["undetermined"][0] == "CL_alpha"
        and content["outcome"]
    )
    (tmp_path / "empty.csv").write_text("")
    refused = flightid.refused(
        "watch",
        tmp_path / "empty.csv",
        "--model",
        "rigid",
        "--vehicle",
        measured / "rigid.toml",
        "--until-end",
    )
    assert "the stream is empty" in refused


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 5])
def test_frequency_and_time_agree_on_the_x29_like_flight(
    flightid: CommandLine, tmp_path: Path, seed: int
) -> None:
    """The low-order equivalent of the closed loop: both within two deviations, the larger ones, of
    each other.
    """
    flightid.done("simulate", "x29-flight", "--seed", seed, "--out", tmp_path / "flight.csv")
    flightid.done(
        "watch",
        tmp_path / "flight.csv",
        "--model",
        "loes",
        "--until-end",
        "--out",
        tmp_path / "out",
    )
    content = comparison(tmp_path / "out")
    other = content["methods"]["frequency-domain"]["parameters"]
    for name in set(other) & set(content["parameters"]):
        one, two = content["parameters"][name], other[name]
        assert abs(one["estimate"] - two["estimate"]) < 2.0 * max(one["std"], two["std"]), name
