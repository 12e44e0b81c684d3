"""Whole processes from a cold start: wall time and peak memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
ONE_THREAD = {
    name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
} | {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
}
# A process counts the memory of what started it as its own peak, so that a small one stands
# between.
LAUNCHER = """
import json, resource, subprocess, sys, time
begin = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
seconds = time.perf_counter() - begin
print(json.dumps([seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, done.returncode, done.stderr.decode(errors="replace")[-2000:]]))
"""  # noqa: E501


class ProcessFailed(Exception):
    """A process that was to be measured ended with an error; the message is the end of what it
    said.
    """


class Measured(NamedTuple):
    """Wall seconds of a process and the peak resident memory of it or of its largest child, MiB."""

    seconds: float
    memory: float


def measured(command: Sequence[str], folder: Path) -> Measured:
    """Run a command in a folder with one thread; killed with all its children where this process is
    interrupted.

    Raises ProcessFailed.
    """
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    launcher = [sys.executable, "-I", "-S", "-c", LAUNCHER, *command]
    with subprocess.Popen(
        launcher,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            said, _ = process.communicate()
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    seconds, kilobytes, code, error = json.loads(said)
    if code != 0:
        lines = error.strip().splitlines()
        raise ProcessFailed(
            f"{' '.join(command[:4])} ...: {lines[-1] if lines else f'exit code {code}'}"
        )
    return Measured(float(seconds), kilobytes / 1024.0)
