"""The command line in this process: a call, and what it printed; a rigid record and the vehicle
file that goes with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from scenarios.cli import main

VEHICLE = """
name = "bomber"
mass = "288017 lb"
wing_area = "1946 ft2"
chord = 4.66344
pitch_inertia = "6.4e6 slug ft2"
airspeed = 200.64984
air_density = 1.055547358
[derivatives]
CL_alpha = 3.4
CL_q = -11.0
CL_de = 0.35
Cm_alpha = -1.3
Cm_q = -28.0
Cm_de = -2.1
"""


@dataclass(frozen=True)
class Call:
    """Exit code and what stood on the two streams."""

    code: object
    out: str
    err: str


class CommandLine:
    """Calls ``flightid`` without a new process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Call:
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        streams = self._capsys.readouterr()
        return Call(ended.value.code, streams.out, streams.err)

    def done(self, *arguments: object) -> str:
        """What a call printed that went well: exit code 0, nothing on stderr."""
        call = self(*arguments)
        assert (call.code, call.err) == (0, "")
        return call.out

    def refused(self, *arguments: object) -> str:
        """The one line of a call that was refused as bad usage or bad input, without the program's
        name.
        """
        call = self(*arguments)
        assert call.code == 2 and call.out == ""
        assert (
            call.err.startswith("flightid: ")
            and call.err.count("\n") == 1
            and call.err.endswith("\n")
        )
        assert "Traceback" not in call.err and "; " in call.err  # what is wrong; what to do
        return call.err.removeprefix("flightid: ").rstrip("\n")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file under a folder with its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
