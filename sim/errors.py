"""Errors that a user can correct, those of users' functions included; times in sentences."""

from __future__ import annotations

import dis
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb
from types import CodeType
from typing import Any


class FlightidError(Exception):
    """A wrong declaration or bad input, in one line.

    Parameters
    ----------
    what : what is wrong, e.g. ``"unit 'kg' does not measure an angle"``.
    where : the file and the row, key, column or object it was found in.
    remedy : what the user should write or do instead.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        line = f"{where}: {what}" if where else what
        super().__init__(f"{line}; {remedy}" if remedy else line)


class RecordError(FlightidError):
    """A record cannot be used as it is."""


class ModelError(FlightidError):
    """A model, effect or parameter is declared wrongly, or used where it cannot be."""


class DeclarationError(FlightidError):
    """A vehicle, scenario or channel-map file that is wrong."""


def raised_by(error: BaseException, file: str) -> bool:
    """Return whether an exception is a fault of the code in ``file``, not a request to stop.

    Every ``Exception`` is a fault, and so are SystemExit and GeneratorExit, which a function that
    is called for a value has no reason to raise. KeyboardInterrupt and the like are faults only if
    a ``raise`` statement of that file raised them: Ctrl-C arrives between statements.
    """
    if isinstance(error, Exception | SystemExit | GeneratorExit):
        return True
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None or trace.tb_frame.f_code.co_filename != file:
        return False
    return _is_raise(trace.tb_frame.f_code, trace.tb_lasti)


def _is_raise(code: CodeType, offset: int) -> bool:
    """Return whether the instruction at an offset of a function's code is a ``raise``."""
    return dis.opname[code.co_code[offset]] == "RAISE_VARARGS"


# ---- Times of a record in sentences


def instant(time: float, digits: int = 4) -> str:
    """Return a time of a record (s) as a text with ``digits`` significant digits.

    Times of day and of the epoch have more digits: they are shown to hundredths of a second.
    """
    if not 10.0 ** (digits - 1) <= abs(time) < 1e11:
        return f"{time:.{digits}g}"
    return f"{time:.2f}".rstrip("0").rstrip(".")


def time_span(begin: float, end: float, digits: int = 6) -> str:
    """Return two times of a record (s) as a text, ``"0 to 12.5 s"``; see ``instant``."""
    return f"{instant(begin, digits)} to {instant(end, digits)} s"


# ---- Errors of users' functions

NO_CHANGE = (
    "make a new value, as in x = 2.0 * s.x instead of s.x *= 2.0 or x *= 2.0; signals that several "
    "functions need are formed in flow"
)


class ChangedArgument(FlightidError):
    """A user's function assigns to a signal that is its argument."""

    def __init__(self, name: str) -> None:
        super().__init__(
            f"a function of a model or an effect assigns to the signal s.{name}", remedy=NO_CHANGE
        )


_DECLARATION = Path(__file__).parent / "declaration"  # has the functions that call users' functions
NO_COMPLEX = (
    "use sin, exp, sqrt, absolute, clip, where and the like of sim.maths: the function must take "
    "complex numbers and arrays"
)


def fault(
    model: str, what: str, function: Callable[..., object], error: BaseException, s: Any, p: Any
) -> FlightidError:
    """Return an error of a user's function as one line: problem, function, file, line and remedy.

    Requests to stop the program, such as Ctrl-C, are raised again.

    Parameters
    ----------
    model : name of the model.
    what : what the function gives, such as ``"rates"``.
    function : the user's function.
    error : the exception that the function raised.
    s, p : signals and parameters, the arguments of the function.
    """
    if not raised_by(error, getattr(getattr(function, "__code__", None), "co_filename", "")):
        raise error
    if isinstance(error, FlightidError) and not isinstance(error, ChangedArgument):
        return error
    where = place(model, what, function, error)
    text = " ".join(f"{type(error).__name__}: {error}".split())
    if _changes_argument(error):
        return ModelError(
            "it changes what it was given, s or p, in place", where=where, remedy=NO_CHANGE
        )
    if isinstance(error, AttributeError) and (error.obj is s or error.obj is p):
        known = [name for name in dir(error.obj) if not name.startswith("_")]
        near = get_close_matches(str(error.name), known, n=1)
        remedy = (
            f"did you mean {near[0]!r}?"
            if near
            else f"declare it, or use one of {', '.join(known)}"
        )
        return ModelError(
            f"there is no {'signal s' if error.obj is s else 'parameter p'}.{error.name}",
            where=where,
            remedy=remedy,
        )
    if isinstance(error, KeyError):
        return ModelError(
            f"{what} gives no {error}", where=where, remedy=f"return a mapping with {error} in it"
        )
    if isinstance(error, TypeError | ValueError):
        return ModelError(text, where=where, remedy=NO_COMPLEX)
    if isinstance(error, ArithmeticError):
        return ModelError(
            text, where=where, remedy="give starts and `initial` values at which it is a number"
        )
    return ModelError(text, where=where, remedy="mend that line")


def _changes_argument(error: BaseException) -> bool:
    """Return whether an error comes of an assignment to a signal or parameter, to an element of
    one, or to a read-only array.
    """
    text = str(error)
    return (
        isinstance(error, ChangedArgument)
        or (isinstance(error, ValueError) and "read-only" in text)
        or (isinstance(error, AttributeError) and text.startswith(("can't set", "can't delete")))
        or (isinstance(error, TypeError) and "does not support item" in text)
    )


def written_in(model: str, what: str, function: Callable[..., object]) -> str:
    """Return the place where a function begins: ``model roll, rates (my_model.py, line 12)``."""
    code = getattr(function, "__code__", None)
    return f"model {model}, {what}" + (
        f" ({code.co_filename}, line {code.co_firstlineno})" if code is not None else ""
    )


def place(model: str, what: str, function: Callable[..., object], error: BaseException) -> str:
    """Return the innermost line of the user's file in the traceback of an error.

    The text is ``model roll, rates (my_model.py, line 12)``.
    """
    files = [(frame.f_code.co_filename, line) for frame, line in walk_tb(error.__traceback__)]
    own = getattr(getattr(function, "__code__", None), "co_filename", None)
    lines = [(file, line) for file, line in files if file == own] or [
        (file, line) for file, line in files if Path(file).parent != _DECLARATION
    ]
    return f"model {model}, {what}" + (f" ({lines[-1][0]}, line {lines[-1][1]})" if lines else "")
