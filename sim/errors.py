"""Errors that a user can correct: problem, place and remedy; times as their sentences name them."""

from __future__ import annotations

import dis
from types import CodeType


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
    """Whether an exception is a fault of the code in ``file``, not a request from outside to stop.

    Every ``Exception`` is, and so are SystemExit and GeneratorExit, which a function that is called
    for a value has no reason to raise. Any other, KeyboardInterrupt among them, is where a
    ``raise`` statement of that file raised it: an interrupt from the keyboard arrives between
    statements.
    """
    if isinstance(error, Exception | SystemExit | GeneratorExit):
        return True
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None or trace.tb_frame.f_code.co_filename != file:
        return False
    return _is_raise(trace.tb_frame.f_code, trace.tb_lasti)


def _is_raise(code: CodeType, at: int) -> bool:
    return dis.opname[code.co_code[at]] == "RAISE_VARARGS"


# ---- Times of a record in sentences


def instant(time: float, digits: int = 4) -> str:
    """A time of a record (s) for a sentence: ``digits`` of it, and hundredths of a second where a
    clock of the day or of the epoch would lose them.
    """
    if not 10.0 ** (digits - 1) <= abs(time) < 1e11:
        return f"{time:.{digits}g}"
    return f"{time:.2f}".rstrip("0").rstrip(".")


def time_span(begin: float, end: float, digits: int = 6) -> str:
    """Two times of a record (s) for a sentence, ``"0 to 12.5 s"``; ``digits`` as of ``instant``."""
    return f"{instant(begin, digits)} to {instant(end, digits)} s"
