"""JSON and TOML texts as plain values, within bounds that every file of ours keeps."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

from scenarios.files.sources import MOST_DOCUMENT, read_content
from sim.errors import DeclarationError, FlightidError

DEEPEST = 64  # tables and lists inside each other
MOST_DIGITS = 300  # of a whole number, which then fits into a float
_SHOWN = 40  # characters of what is wrong


class DocumentError(ValueError):
    """A text that is no JSON or TOML, or holds what no file of ours does; its text says what, in a
    few words, and ``key`` where if that is known.
    """

    def __init__(self, what: str, key: str = "") -> None:
        super().__init__(what)
        self.key = key


def json_value(content: bytes | str) -> Any:
    """The value of a strict JSON text.

    Raises
    ------
    DocumentError : it is not UTF-8, no JSON, nested deeper than ``DEEPEST``, or holds a number
        that is not finite or has too many digits.
    """
    try:
        value = json.loads(content, parse_int=_whole, parse_constant=_constant)
    except DocumentError:
        raise
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEEPEST} levels") from None
    except UnicodeDecodeError:
        raise DocumentError("not UTF-8 text") from None
    except ValueError as error:
        raise DocumentError(f"not JSON: {' '.join(str(error).split())}") from None
    _refuse_extremes(value, finite=True)
    return value


def toml_value(text: str) -> dict[str, Any]:
    """The tables of a TOML text, in which infinite numbers may stand.

    Raises
    ------
    DocumentError : it is no TOML, nested deeper than ``DEEPEST``, or holds a whole number of
        too many digits.
    """
    try:
        value = tomllib.loads(text)
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEEPEST} levels") from None
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"not valid TOML: {' '.join(str(error).split())}") from None
    except ValueError:  # Python's own limit of digits, and dates that no calendar has
        raise DocumentError(f"not valid TOML: a number of more than {MOST_DIGITS} digits, or no date") from None
    _refuse_extremes(value, finite=False)
    return value


def read_json(path: Path, error: type[FlightidError] = DeclarationError, wanted: str = "the folder of a study") -> Any:
    """The value of a JSON file.

    Raises
    ------
    FlightidError : of the kind ``error``: it cannot be read, or as ``json_value``; the line
        names the file and what to name instead, ``wanted``.
    """
    content = read_content(path, error, wanted, MOST_DOCUMENT)
    try:
        return json_value(content)
    except DocumentError as fault:
        raise error(
            str(fault),
            where=f"{path}, key {fault.key}" if fault.key else str(path),
            remedy=f"name {wanted}",
        ) from None


def found_json(path: Path) -> Any:
    """The value of a JSON file that may be another's or damaged: None where there is none or it is
    no strict JSON.
    """
    try:
        return read_json(path)
    except DeclarationError:
        return None


def _whole(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise DocumentError(f"a number of {len(text)} digits")
    return int(text)


def _constant(word: str) -> float:
    raise DocumentError(f"{word} is not a finite number")


def _refuse_extremes(value: Any, *, finite: bool) -> None:
    """Go through all values, level by level so that no depth can overrun this."""
    level, depth = [("", value)], 0
    while level:
        if depth > DEEPEST:
            raise DocumentError(f"nested deeper than {DEEPEST} levels", level[0][0][:_SHOWN])
        inner: list[tuple[str, Any]] = []
        for key, each in level:
            if isinstance(each, dict):
                inner += [(f"{key}.{name}" if key else str(name), item) for name, item in each.items()]
            elif isinstance(each, list):
                inner += [(key, item) for item in each]
            elif isinstance(each, int) and abs(each) >= 10**MOST_DIGITS:
                raise DocumentError(
                    f"{str(each)[:_SHOWN]}... is not a number to compute with: it has more than {MOST_DIGITS} digits",
                    key,
                )
            elif finite and isinstance(each, float) and not math.isfinite(each):
                raise DocumentError("a number beyond the range of floats", key)
        level, depth = inner, depth + 1
