"""Lab 7: a user's own files, read, checked, identified and diagnosed; and two examples of such
files, a table as a flight-test system exports it and the log of a flight computer.
"""

from __future__ import annotations

import io
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from flightid.labs.workings import PREFIX, Scratch, recorder_log

if TYPE_CHECKING:
    import flightid
    from scenarios.trials.planted_flights import SimulatedTrace
    from sim.record import Record

Found = TypeVar("Found")

# A vehicle of the library for each model, to be overwritten with one's own numbers.
VEHICLES = {
    "rigid": "",
    "loes": "",
    "longitudinal": "navion_longitudinal",
    "lateral": "navion_lateral",
    "flexible": "bomber_ac1",
    "ballistic": "ballistic_target",
    "multirotor": "",
}
TABLE, LOG, OWN = "a table (CSV)", "a log of ArduPilot", "my own files"
SOURCES = (TABLE, LOG, OWN)
# what may be dropped into the lab
SUFFIXES = [
    ".csv",
    ".txt",
    ".bin",
    ".log",
    ".ulg",
    ".xlsx",
    ".mat",
    ".h5",
    ".mf4",
    ".tdms",
    ".parquet",
]
SHORT = ("flight.rate=20 Hz", "flight.train.duration=18 s", "flight.validate.duration=14 s")
EXAMPLE = "trace-vane"  # two records of an aircraft with a vane far ahead
HEADERS = {
    "elevator": ("Elev pos", "deg"),
    "alpha": ("AoA1", "deg"),
    "q": ("Pitch Rate [deg/s]", "deg/s"),
    "nz": ("N_z", "g"),
}
MAP = """time = {column = "Stamp (ms)", unit = "ms"}
elevator = {column = "Elev pos", unit = "deg"}
alpha = {column = "AoA1", unit = "deg"}
q = "Pitch Rate [deg/s]"
nz = "N_z"
"""
LOES = """name = "augmented"
airspeed = 295.5
gravity = 9.80665
[derivatives]
L_alpha = -1.9
M_alpha = -14.0
L_delta = 0.0
M_delta = 0.38
L_q = 1.0
M_q = -3.7
inv_tau = 8.0
delay = 0.08
"""
MULTIROTOR = """name = "quadrotor"
[derivatives]
L_p = -1.0
L_lat = 60.0
L_0 = 0.0
M_q = -1.0
M_lon = 60.0
M_0 = 0.0
N_r = -0.5
N_ped = 10.0
N_0 = 0.0
Z_col = -20.0
Z_0 = 0.0
motor_time_constant = 0.04
delay = 0.01
"""
# where uploaded files lie, which says nothing to who uploaded them
_SCRATCH = re.compile(rf"\S*/{PREFIX}[^/\s]+/")
# digits that only rounding leaves
_LONG = re.compile(r"\b\d+\.\d{10,}\b")
# a function of Python has read the vehicle file, so that its name is not in the command
_WITHOUT_VEHICLE = re.compile(r"(\bflightid diagnose .* --model \S+)(?! --vehicle)(?=\s|$)")


@dataclass(frozen=True, eq=False)
class Kept:
    """Uploaded files in a folder that lives as long as this."""

    folder: Scratch
    records: tuple[Path, ...]
    vehicle: Path
    channels: Path | None


def vehicle_text(model: str, source: str = TABLE) -> str:
    """Return a vehicle file to begin with: for ``rigid`` that of the example, whose starting values
    are up to 30 % off, else one of the library.
    """
    import flightid

    if model == "rigid":
        text = recorder_log.vehicle_text() if source == LOG else _flown().vehicle_file
        return _LONG.sub(lambda found: f"{float(found[0]):.10g}", text)
    texts = {"loes": LOES, "multirotor": MULTIROTOR}
    return texts[model] if model in texts else flightid.vehicle(VEHICLES[model]).to_toml()


def files_of(source: str) -> tuple[tuple[str, bytes], ...]:
    """Return the name and content of the records of an example; none for ``OWN``."""
    return {TABLE: example, LOG: recorder_log.example}.get(source, tuple)()


def map_of(source: str) -> str:
    """Return the channel map of an example; empty for ``OWN``."""
    return {TABLE: MAP, LOG: recorder_log.MAP}.get(source, "")


def kept(records: Sequence[tuple[str, bytes]], vehicle: str, channels: str = "") -> Kept:
    """Return the files of a student: records by name and content, the text of the vehicle file, and
    that of the channel map, if there is one.

    Raises
    ------
    FlightidError : two files have one name.
    """
    from sim.errors import RecordError

    names = [Path(name).name for name, _ in records]
    for name in names:
        if names.count(name) > 1:
            raise RecordError("two files have this name", where=name, remedy="rename one")
    folder = Scratch()
    home = folder.path
    for name, (_, content) in zip(names, records, strict=True):
        (home / name).write_bytes(content)
    (home / "vehicle.toml").write_text(vehicle, encoding="utf-8", newline="\n")
    if channels.strip():
        (home / "map.toml").write_text(channels, encoding="utf-8", newline="\n")
    return Kept(
        folder,
        tuple(home / name for name in names),
        home / "vehicle.toml",
        home / "map.toml" if channels.strip() else None,
    )


def tried(what: Callable[[], Found]) -> tuple[Found | None, str]:
    """Return the result of a function and an empty text, or None and its error in one line."""
    from sim.errors import FlightidError

    try:
        return what(), ""
    except FlightidError as error:
        # The functions of Python raise it again in their words; the lab prints commands.
        first = error.__context__
        return None, _plain(str(first if isinstance(first, FlightidError) else error))


def _plain(text: str) -> str:
    """Return a sentence on one line, without the folder of the uploaded files."""
    return _SCRATCH.sub("", " ".join(text.split()))


def check_remarks(found: flightid.Check) -> list[str]:
    """Return findings and warnings of the check, in the words of the command."""
    look = found.details.look
    return [_plain(each) for each in (*found.sentences, *look.doubts, *look.set_aside)]


def fit_remarks(found: flightid.Identification) -> list[str]:
    """Return warnings and notes of an identification, in the words of the command."""
    fit = found.details.found
    reading = (fit.reading.sentence,) if fit.reading else ()
    lines = (*fit.doubts, *fit.cautions, *reading, *fit.look.set_aside, *fit.notes)
    return [_WITHOUT_VEHICLE.sub(r"\1 --vehicle vehicle.toml", _plain(each)) for each in lines]


def diagnosis_remarks(found: flightid.Diagnosis) -> list[str]:
    """Return warnings and notes of a diagnosis, in the words of the command."""
    from scenarios.diagnosis.evidence import warnings_of

    details = found.details
    return [_plain(each) for each in (*details.doubts, *warnings_of(details), *found.notes)]


def read(given: Kept) -> list[flightid.Record]:
    """Return the records with the channels that are found in them."""
    import flightid

    return [flightid.read_record(path, channels=given.channels) for path in given.records]


def checked(given: Kept) -> flightid.Check:
    """Return the kinematic check of the sensors."""
    import flightid

    return flightid.check(given.records, given.vehicle, channels=given.channels)


def identified(given: Kept, model: str, method: str = "output-error") -> flightid.Identification:
    """Return parameters from all records together."""
    import flightid

    return flightid.identify(
        given.records, model, given.vehicle, method=method, channels=given.channels
    )


def diagnosed(given: Kept, model: str) -> flightid.Diagnosis:
    """Return the diagnosis of the model; the last of several records, or the last part of one, is
    held out.
    """
    import flightid

    return flightid.diagnose(given.records, model, given.vehicle, channels=given.channels)


def report(found: flightid.Diagnosis) -> bytes:
    """Return the report as one HTML file."""
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        return found.report(Path(scratch, "report.html")).read_bytes()


def channel_rows(records: Sequence[flightid.Record]) -> list[list[str]]:
    """Return a row for each channel of each record: samples, unit, least and greatest value."""
    rows = []
    for record in records:
        for name, unit in record.units.items():
            values: Any = record[name]
            rows.append(
                [
                    record.name,
                    name,
                    unit,
                    str(int(np.isfinite(values).sum())),
                    f"{np.nanmin(values):.4g}",
                    f"{np.nanmax(values):.4g}",
                ]
            )
    return rows


@cache
def _flown() -> SimulatedTrace:
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of

    return fly_trace(trace_scenario_of(*load_document(EXAMPLE, SHORT)), 1)


def example() -> tuple[tuple[str, bytes], ...]:
    """Return two records as a flight-test system exports them: milliseconds, degrees, other column
    names, rounded values, missing samples.
    """
    found = _flown()
    return (("point_1.csv", exported(found.train)), ("point_2.csv", exported(found.validate)))


def exported(record: Record, missing: Mapping[str, int] | None = None) -> bytes:
    """Return a record as such a CSV file, with some samples left empty at regular intervals."""
    from scenarios.files.units import to_si
    from sim.errors import DeclarationError

    holes = {"alpha": 37} if missing is None else missing
    out = io.StringIO()
    out.write(
        ",".join(["Stamp (ms)", *(HEADERS[channel.name][0] for channel in record.channels)]) + "\n"
    )
    factors = {
        c.name: float(to_si(1.0, HEADERS[c.name][1], c.unit, c.name, DeclarationError))
        for c in record.channels
    }
    for at, time in enumerate(record.time):
        cells = [
            ""
            if channel.name in holes and at % holes[channel.name] == 5
            else f"{channel.values[at] / factors[channel.name]:.4f}"
            for channel in record.channels
        ]
        out.write(",".join([f"{100000 + 1000 * time:.0f}", *cells]) + "\n")
    return out.getvalue().encode()
