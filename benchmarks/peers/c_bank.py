"""The filters of many records in C written by hand (`ekf.c`), compiled on the spot and called
through ctypes.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.peers.short_period import Problem, scales_of

SOURCE = Path(__file__).with_name("ekf.c")


def compiler() -> str | None:
    """The C compiler of this machine, None where there is none."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def compiled() -> ctypes.CDLL:
    """The library, compiled for this processor."""
    command = compiler()
    assert command is not None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ekf.so"
        subprocess.run(
            [
                command,
                "-O3",
                "-march=native",
                "-shared",
                "-fPIC",
                "-o",
                str(path),
                str(SOURCE),
                "-lm",
            ],
            check=True,
        )
        return ctypes.CDLL(str(path))


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    run = compiled().filter_runs
    run.restype = None
    z = np.ascontiguousarray(np.transpose(problem["z_runs"], (2, 1, 0)))
    runs, samples, _ = z.shape
    inputs = [
        np.array(scales_of(problem)),
        problem["elevator"],
        z,
        problem["noise_std"] ** 2,
        problem["start"],
        problem["start_std"] ** 2,
    ]
    held = [np.ascontiguousarray(each, dtype=float) for each in inputs]
    dt = ctypes.c_double(float(problem["time"][1] - problem["time"][0]))

    def work() -> dict[str, np.ndarray]:
        mean, variance, total = np.empty((runs, 8)), np.empty((runs, 8)), np.empty(runs)
        arrays = [each.ctypes.data_as(ctypes.c_void_p) for each in (*held, mean, variance, total)]
        run(ctypes.c_int(runs), ctypes.c_int(samples), dt, *arrays)
        return {
            "estimate": mean[:, 2:].T,
            "estimate_std": np.sqrt(variance[:, 2:]).T,
            "log_likelihood": total,
        }

    return work
