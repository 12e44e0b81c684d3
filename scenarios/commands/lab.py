"""`flightid lab`: teaching notebooks listed, opened, copied, and their instructor's keys."""

from __future__ import annotations

import importlib.util
import re
import shutil
import socket
import subprocess
import sys
from importlib.resources import as_file, files
from pathlib import Path

from sim.errors import DeclarationError, FlightidError

_FILE = re.compile(r"lab(\d+)_\w+\.py")
_TITLE = re.compile(r'app_title="Lab \d+: ([^"]+)"')
_HOST = "127.0.0.1"  # a notebook runs code: nobody else's browser may reach it


def lab_files() -> dict[int, Path]:
    """The notebooks by their number, in order."""
    with as_file(files("flightid.labs")) as folder:
        found = {int(match[1]): path for path in folder.iterdir() if (match := _FILE.fullmatch(path.name))}
    return dict(sorted(found.items()))


def title_of(path: Path) -> str:
    """The title that a notebook gives itself."""
    found = _TITLE.search(path.read_text(encoding="utf-8"))
    return found[1] if found else path.stem


def list_labs() -> None:
    """One line for each lab."""
    for number, path in lab_files().items():
        print(f"{number}  {title_of(path)}")
    print("flightid lab N opens one; --copy DIR makes it yours; --key prints what an instructor wants to know")


def show_key(number: int) -> None:
    """The instructor's key of a lab, as Markdown."""
    print((_lab(number).parent / "keys" / f"lab{number}.md").read_text(encoding="utf-8"), end="")


def copy_lab(number: int, folder: Path) -> Path:
    """A copy of a lab in a folder that is made where it is missing.

    Raises
    ------
    DeclarationError : the folder has one already. FlightidError : it cannot be written.
    """
    path = _lab(number)
    target = folder / path.name
    if target.exists():
        raise DeclarationError("there is such a file already, and it may be yours", where=str(target), remedy="name another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    except OSError as error:
        raise FlightidError(f"cannot be written ({error.strerror})", where=str(target), remedy="name a folder that you may write in") from None
    print(f"copied to {target}; marimo edit {target} opens it")
    return target


def open_lab(number: int, edit: bool, port: int | None, browser: bool, folder: Path | None) -> int:
    """Serve a lab to a browser on this machine until it is stopped, and return the exit code.

    ``edit`` opens the copy in ``folder`` (None: the current one), which is made if it is missing: the installed lab stays as it is.

    Raises
    ------
    DeclarationError : there is no such lab, marimo is not installed, or the port is taken.
    """
    path = _lab(number)
    if importlib.util.find_spec("marimo") is None:
        raise DeclarationError("labs are notebooks of marimo, which is not installed", where="flightid lab", remedy='pip install "flightid[labs]"')
    if port is not None:
        _refuse_taken(port)
    if edit:
        own = (folder or Path()) / path.name
        path = own if own.exists() else copy_lab(number, folder or Path())
    command = [sys.executable, "-m", "marimo", "edit" if edit else "run", str(path), "--host", _HOST]
    command += ["--port", str(port)] if port is not None else []
    command += [] if browser else ["--headless"]
    command += ["--skip-update-check"] if edit else []
    try:
        return subprocess.call(command)
    except KeyboardInterrupt:
        return 0


def _lab(number: int) -> Path:
    known = lab_files()
    if number not in known:
        raise DeclarationError(f"there is no lab {number}", where="flightid lab", remedy=f"use a number from 1 to {max(known)}")
    return known[number]


def _refuse_taken(port: int) -> None:
    with socket.socket() as probe:
        if probe.connect_ex((_HOST, port)) == 0:
            raise DeclarationError(f"port {port} is taken", where="--port", remedy="name another one, or leave it out")
