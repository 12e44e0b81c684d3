"""A Dask cluster of processes of its own: a scheduler and its workers, as a user starts them."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.unit.scenarios.tasks.process_tree import below

ROOT = Path(__file__).parents[4]
PATIENCE = 60.0  # s until a process must have begun


class Cluster:
    """``folder`` : what the processes tell. A worker has one thread; with a nanny, as Dask starts
    it usually, it is begun again when it dies.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self._count = 0

    def start(self, workers: int = 2, nannies: int = 0, path: Path = ROOT) -> None:
        """A scheduler where none is left, and as many workers, the first ``nannies`` of them with
        nannies.
        """
        if self.scheduler is None:
            self.scheduler = self._process(
                "dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                str(self.port),
                "--no-show",
                path=path,
            )
        for at in range(workers):
            options = [
                "--nthreads",
                "1",
                "--no-dashboard",
                *([] if at < nannies else ["--no-nanny"]),
            ]
            worker = self._process(
                "dask_worker",
                self.address,
                *options,
                "--local-directory",
                str(self.folder),
                path=path,
            )
            self.workers.append(worker)

    def ready(self, workers: int = 2) -> None:
        """Waits until the workers that live have been registered with the scheduler."""
        from distributed import Client

        with Client(self.address, timeout=PATIENCE, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)

    def kill_scheduler(self) -> None:
        assert self.scheduler is not None
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = None

    def kill_worker(self) -> None:
        """The last one, with -9."""
        worker = self.workers.pop()
        worker.kill()
        worker.wait()

    def end(self) -> None:
        for process in (*self.workers, *([self.scheduler] if self.scheduler else [])):
            for each in (process.pid, *below(process.pid)):
                try:
                    os.kill(each, signal.SIGKILL)
                except ProcessLookupError:
                    continue
            process.wait()
        self.workers, self.scheduler = [], None

    def _process(self, command: str, *options: str, path: Path) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": str(path), "OPENBLAS_NUM_THREADS": "1"}
        self._count += 1
        with open(self.folder / f"{self._count}-{command}.log", "wb") as log:
            arguments = [
                sys.executable,
                "-m",
                f"distributed.cli.{command}",
                *options,
                "--dashboard-address",
                "127.0.0.1:0",
            ]
            return subprocess.Popen(
                arguments, cwd=self.folder, env=environment, stdout=log, stderr=subprocess.STDOUT
            )


@contextmanager
def cluster_of(
    folder: Path, workers: int = 2, nannies: int = 0, path: Path = ROOT
) -> Iterator[Cluster]:
    pytest.importorskip("distributed")
    folder.mkdir(parents=True, exist_ok=True)
    cluster = Cluster(folder)
    try:
        cluster.start(workers, nannies, path)
        cluster.ready(workers)
        yield cluster
    finally:
        cluster.end()


def gone(processes: list[int], within: float) -> bool:
    """Whether they end within so many seconds."""
    until = time.monotonic() + within
    while any(Path(f"/proc/{each}").exists() for each in processes):
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True
