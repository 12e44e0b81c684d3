"""Exponents are those of known growth, series measure what they say, and whole commands are asked
for as named.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.comparison.compare import QUICK, Pace
from benchmarks.comparison.whole_process import Measured
from benchmarks.scaling import processes
from benchmarks.scaling.catalogue import TABLES
from benchmarks.scaling.flexible import full_order, with_free, with_modes
from benchmarks.scaling.series import Series, exponent, grown


def quiet(text: str) -> None:
    return None


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_the_large_end(power: float) -> None:
    sizes = [1, 10, 100, 200, 400]
    times = [7.0, 7.0, *(3.0 * size**power for size in sizes[2:])]
    assert exponent(sizes, times) == pytest.approx(power, abs=1e-12)


def test_a_series_has_a_row_for_each_size_and_the_exponent() -> None:
    def slept(size: int) -> Callable[[], None]:
        return lambda: time.sleep(0.002 * size)

    table = grown(
        Series("naps", "Naps", "About.", "naps", (1, 2, 4), {"sleep": slept}), Pace(rounds=3), quiet
    )
    assert [row[0] for row in table.rows] == ["1", "2", "4", "exponent"] and table.head == (
        "naps",
        "sleep",
    )
    assert table.data["sizes"] == [1, 2, 4] and len(table.data["works"]["sleep"]["seconds"]) == 3
    # A sleep is never shorter than asked for; on a busy machine it may be much longer.
    found = table.data["works"]["sleep"]
    medians = [each["median"] for each in found["seconds"]]
    assert all(took >= 0.002 * size for size, took in zip((1, 2, 4), medians, strict=True))
    assert found["exponent"] == pytest.approx(exponent([1, 2, 4], medians))
    assert (
        len(
            grown(
                Series("naps", "Naps", "About.", "naps", (1, 2, 4), {"sleep": slept}), QUICK, quiet
            ).rows
        )
        == 3
    )


def test_models_have_the_states_and_parameters_that_rows_name() -> None:
    from sim.declaration.compile import compile_model

    for modes in (0, 2, 4):
        assert len(compile_model(with_modes(modes)).states) == 2 + 2 * modes
    for count in (6, 24, 66):
        free = with_free(count).parameters.free_names
        assert free == full_order()[1].parameters.free_names[:count] and len(free) == count
        assert np.all(np.isfinite([with_free(count).parameters[name].prior_std for name in free]))


def test_two_jobs_are_held_against_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_if(command: Sequence[str], folder: Path) -> Measured:
        return Measured(8.0 / int(command[command.index("--jobs") + 1]), 50.0)

    monkeypatch.setattr(processes, "measured", as_if)
    table = processes.jobs(Pace(), tmp_path, quiet)
    assert [row[0] for row in table.rows] == [
        f"`{name} --runs {runs}`" for name, _, runs, _, _ in processes.STUDIES
    ]
    assert all(row[1] == "8 s" and row[2] == "4 s" and row[3].startswith("2") for row in table.rows)


@pytest.mark.long
def test_memory_is_told_of_every_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Sequence[str]] = []

    def as_if(command: Sequence[str], folder: Path) -> Measured:
        asked.append(command)
        return Measured(1.5, 123.4)

    monkeypatch.setattr(processes, "measured", as_if)
    table = processes.memory(Pace(), tmp_path, quiet)
    assert len(asked) == len(table.rows) and all(row[1:] == ("123", "1.5 s") for row in table.rows)
    assert any("100000" in command for command in asked)
    named = [
        part
        for command in asked
        for part in command
        if part.endswith((".toml", ".csv")) and part != "record.csv"
    ]
    assert named and all(Path(part).is_file() for part in named)


def test_every_table_has_a_name() -> None:
    assert list(TABLES) == [
        "samples",
        "states",
        "parameters",
        "candidates",
        "runs",
        "jobs",
        "memory",
    ]
