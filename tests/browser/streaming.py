"""A stream at the rate of telemetry, watched by the command, and a line to its page that can be
cut.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType

from tests import loes_problem
from tests.bases import LOES_CONSTANTS, LOES_VALUES
from tests.browser.serving import ROOT

RATE = 40.0  # Hz
MANEUVER = 20.0  # s, flown again and again
# Rows of a file to standard output when they are due, the time going on; when it began, in seconds
# of the clock, to standard error.
_SENDER = """
import sys, time
header, *rows = open(sys.argv[1]).read().splitlines()
rate, count, begun = float(sys.argv[2]), int(sys.argv[3]), time.time()
print(begun, file=sys.stderr, flush=True)
print(header, flush=True)
for k in range(count):
    time.sleep(max(0.0, begun + k / rate - time.time()))
    print("%.6f,%s" % (k / rate, rows[k % len(rows)].split(",", 1)[1]), flush=True)
"""


class Watched:
    """A stream of so many seconds and the watch of it, ended behind the `with` block. `address` is
    the page's, `begun` when it began.
    """

    def __init__(self, folder: Path, seconds: float) -> None:
        self.rows = round(seconds * RATE)
        flown = loes_problem.record(1, duration=MANEUVER - 1.0 / RATE, rate=RATE)
        table = [flown.time, *(channel.values for channel in flown.channels)]
        text = [
            "time,stick [in],alpha,q,nz",
            *(",".join(f"{value:.9g}" for value in row) for row in zip(*table, strict=True)),
        ]
        (folder / "flown.csv").write_text("\n".join(text) + "\n")
        start = {
            **{name: 1.3 * value for name, value in LOES_VALUES.items()},
            "L_q": 1.0,
            "delay": 0.05,
        }
        lines = [
            'name = "demonstrator"',
            *(f"{name} = {value}" for name, value in LOES_CONSTANTS.items()),
            "[derivatives]",
        ]
        (folder / "vehicle.toml").write_text(
            "\n".join([*lines, *(f"{name} = {value}" for name, value in start.items())]) + "\n"
        )
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
        self._sender = subprocess.Popen(
            [sys.executable, "-c", _SENDER, str(folder / "flown.csv"), str(RATE), str(self.rows)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        command = [
            sys.executable,
            "-m",
            "scenarios",
            "watch",
            "-",
            "--model",
            "loes",
            "--vehicle",
            str(folder / "vehicle.toml"),
            "--page",
        ]
        with (folder / "printed.txt").open("wb") as printed:
            self.process = subprocess.Popen(
                [*command, "--out", str(folder / "out")],
                stdin=self._sender.stdout,
                stdout=printed,
                stderr=subprocess.PIPE,
                env=environment,
            )
        assert self.process.stderr is not None and self._sender.stderr is not None
        self.address = self.process.stderr.readline().decode().split()[-1]
        self.port = int(self.address.rstrip("/").rpartition(":")[2])
        self.begun = float(self._sender.stderr.readline())

    def __enter__(self) -> Watched:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in (self.process, self._sender):
            if process.poll() is None:
                process.kill()
            process.wait()
            for pipe in (process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()

    def busy(self) -> float:
        """Seconds of computing of the watch so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self) -> float:
        """Of the watch, MB resident."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(
            float(line.split()[1]) / 1024.0
            for line in status.splitlines()
            if line.startswith("VmRSS")
        )


class Line:
    """A line to a port of this machine that can be cut and restored; what goes to it is addressed
    to that port.
    """

    def __init__(self, port: int) -> None:
        self._to, self._held, self._cut = port, set[socket.socket](), False
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self.address = f"http://127.0.0.1:{self.port}/"
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Break every connection and take no new one."""
        self._cut = True
        for held in list(self._held):
            with contextlib.suppress(OSError):
                held.shutdown(socket.SHUT_RDWR)

    def restore(self) -> None:
        """Take connections again."""
        self._cut = False

    def close(self) -> None:
        """Cut it for good."""
        self.cut()
        self._listening.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                if self._cut:
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self._to))
                threading.Thread(target=self._pass, args=(near, far, True), daemon=True).start()
                threading.Thread(target=self._pass, args=(far, near, False), daemon=True).start()

    def _pass(self, near: socket.socket, far: socket.socket, outward: bool) -> None:
        self._held.add(near)
        with contextlib.suppress(OSError):
            while piece := near.recv(1 << 16):
                far.sendall(
                    piece.replace(f":{self.port}".encode(), f":{self._to}".encode())
                    if outward
                    else piece
                )
        for each in (near, far):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._held.discard(near)
        near.close()
