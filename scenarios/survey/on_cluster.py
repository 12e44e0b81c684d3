"""A survey's work as the workers of a cluster do it: each flight's files come back over the network, and the folder is written here."""

from __future__ import annotations

import base64
import io
import os
import socket
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.own_models import is_model_file
from scenarios.survey.flights import Flight
from scenarios.survey.one_flight import FOLDER, KEPT, Diagnoses
from scenarios.survey.pooled_fits import PooledFits
from scenarios.tasks.work import Row, Task

FILES = "files"  # the column in which a flight's files come back, a ZIP archive as text
STUDY = "diagnosis.json"


@dataclass(frozen=True)
class Sent:
    """The same work for a cluster.

    ``work``: as this machine would do it, into its folder. ``place``: the current folder, from which paths are read.
    ``typed``: the words of the command line, which pages show. ``inputs``: files that are there, which every worker has
    to see at the same path.
    """

    work: Diagnoses | PooledFits
    place: Path
    typed: tuple[str, ...]
    inputs: tuple[Path, ...]

    @property
    def name(self) -> str:
        return self.work.name

    @property
    def block(self) -> int:
        return self.work.block

    @property
    def columns(self) -> Mapping[str, str]:
        return {**self.work.columns, FILES: "text"}

    def identity(self) -> Mapping[str, Any]:
        return self.work.identity()

    def unready(self) -> tuple[str, str] | None:
        """Why this machine cannot do the work, and the remedy; None where it can."""
        for path in self.inputs:
            if not (self.place / path).is_file():
                return (
                    f"the worker on {socket.gethostname()} does not see {self.place / path}",
                    "put the flights on a disk that every worker sees at the same path",
                )
        return None

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Each task in a temporary folder; its files are part of its row."""
        os.chdir(self.place)  # of a process that does this work alone
        sys.argv = list(self.typed)
        out: list[Row | str] = []
        for task in tasks:
            with TemporaryDirectory(prefix="flightid-") as scratch:
                own = Path(scratch) / FOLDER / self.work.flights[task.number].name
                own.mkdir(parents=True)
                (row,) = replace(self.work, folder=Path(scratch)).run([task])
                out.append(row if isinstance(row, str) else {**row, FILES: _packed(own)})
        return out

    def taken(self, row: Row) -> Row:
        """Write the files that came with a row into this machine's folder; the row without them. Raises FlightidError."""
        files = _unpacked(str(row[FILES]))
        folder = self.work.folder / FOLDER / str(row["flight"])
        if STUDY in files:
            (folder / KEPT).unlink(missing_ok=True)  # what it says is no longer of this folder
            with study_folder(folder, STUDY) as scratch:
                for name, content in files.items():
                    if name != KEPT:
                        (scratch / name).write_bytes(content)
            files = {KEPT: files[KEPT]}
        for name, content in files.items():
            part = folder / f".{name}.part"
            part.write_bytes(content)
            os.replace(part, folder / name)
        return {**row, FILES: ""}


def sent(work: Diagnoses | PooledFits) -> Sent:
    """A survey's work, to be given to a cluster by this process."""
    files = {path: None for flight in work.flights for path in _inputs(flight) if path.is_file()}
    folder = Path.cwd()
    return Sent(replace(work, folder=folder / work.folder), folder, tuple(sys.argv), tuple(files))


def _inputs(flight: Flight) -> list[Path]:
    model = [Path(flight.model)] if is_model_file(flight.model) else []
    return [*flight.records, *model, *(path for path in (flight.channels, flight.effects) if path is not None)]


def _packed(folder: Path) -> str:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        for path in sorted(folder.iterdir()):
            files.write(path, path.name)
    return base64.b64encode(archive.getvalue()).decode("ascii")


def _unpacked(text: str) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(text))) as files:
        return {Path(each.filename).name: files.read(each) for each in files.infolist()}
