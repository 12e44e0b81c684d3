"""Python files of users: run once, since a user names them, and every error in them told by file and line."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from scenarios.files.sources import Source
from sim.errors import DeclarationError, FlightidError, raised_by

WANTED = "a Python file"
MODULE = "flightid_of_user_"  # begins the name of every module that a user's file makes: tracebacks show by it whose code failed


def run_python(source: Source, kind: str) -> ModuleType:
    """The module that a file makes, run as any Python program is; ``kind`` is part of its name while it runs, ``"effects"``.

    Raises
    ------
    DeclarationError : it is no Python file, or anything in it fails, with its line.
    """
    path, where = source.path, str(source.path)
    if path.suffix != ".py":
        raise DeclarationError("this is no Python file", where=where, remedy="name a file that ends in .py")
    name = f"{MODULE}{kind}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their own module up
    try:
        exec(compile(source.content, where, "exec", dont_inherit=True), module.__dict__)  # these bytes were hashed
    except FlightidError as error:
        inside = f"{error.where}: " if error.where else ""
        raise DeclarationError(f"{inside}{error.what}", where=f"{where}{_line(error, path)}", remedy=error.remedy) from None
    except BaseException as error:  # the file is a user's, and anything may be wrong with it
        if not raised_by(error, where):
            raise
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) and error.lineno else _line(error, path)
        text = error.msg if isinstance(error, SyntaxError) else str(error)
        what = " ".join(f"{type(error).__name__}: {text}".split())
        raise DeclarationError(what, where=f"{where}{line}", remedy="mend that line") from None
    finally:
        sys.modules.pop(name, None)
    return module


def _line(error: BaseException, path: Path) -> str:
    """The line of the user's file that the error came through last."""
    found, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            found = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return found
