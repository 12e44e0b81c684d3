"""Users' TOML and Python files: every fault becomes one line that names file, key and remedy. The
channels that a record may have, and the map that finds them under other headers.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from scenarios.files.sources import DocumentError, Source, read_source, toml_value
from sim.errors import DeclarationError, FlightidError, raised_by

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    from scenarios.files.schemas import ColumnEntry

# ---- Users' TOML files against a pydantic schema

Schema = TypeVar("Schema", bound="BaseModel")

_LIMITS = {
    "greater_than": ("is not above {gt}", "give a value above {gt}"),
    "greater_than_equal": ("is below {ge}", "give {ge} or more"),
    "less_than": ("is not below {lt}", "give a value below {lt}"),
    "less_than_equal": ("is above {le}", "give {le} or less"),
    "finite_number": ("is not a finite number", "give a finite number"),
}
# Order of errors: a misspelt key is both unknown and missing.
_ORDER = ("extra_forbidden", "missing")
# of a value that may be several: pydantic puts them after the key
_KINDS = ("float", "int", "str", "constrained-str")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the content of a TOML file. Raises DeclarationError if it is missing, unreadable,
    or as ``toml_of`` says.
    """
    return toml_of(read_toml_source(path))


def read_toml_source(path: str | Path | Source) -> Source:
    """Read a TOML file, or return it if already read.

    Raises DeclarationError if it is missing or unreadable.
    """
    if isinstance(path, Source):
        return path
    return read_source(path, DeclarationError, "a TOML file")


def toml_of(source: Source) -> dict[str, Any]:
    """Return the content of a TOML file that was read.

    Raises
    ------
    DeclarationError : it is not UTF-8, not TOML (with line and column), or as ``toml_value``.
    """
    where = str(source.path)
    try:
        return toml_value(source.content.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise DeclarationError("not UTF-8 text", where=where, remedy="save it in UTF-8") from None
    except DocumentError as error:
        where = f"{where}, key {error.key}" if error.key else where
        raise DeclarationError(
            str(error), where=where, remedy='write key = value, texts in "quotes"'
        ) from None


@contextlib.contextmanager
def named_after(file: str) -> Iterator[None]:
    """Put the file in front of the place of an error that does not name it."""
    try:
        yield
    except FlightidError as error:
        if file in error.where:
            raise
        where = f"{file}, {error.where}" if error.where else file
        raise type(error)(error.what, where=where, remedy=error.remedy) from None


def checked(
    schema: type[Schema], content: Mapping[str, Any], path: str | Path, inside: str = ""
) -> Schema:
    """The content as an instance of a schema; ``inside``: table it is in, e.g. ``"modes[1]"``.

    Raises
    ------
    DeclarationError : one line on the first fault: an unknown key before a missing one before a
        wrong value.
    """
    from pydantic import ValidationError

    try:
        return schema.model_validate(dict(content))
    except ValidationError as error:
        raise _one_line(error, schema, path, inside) from None


def closest(word: str, allowed: Iterable[str]) -> str:
    """``"did you mean 'alpha'?"``, or all choices if none is similar."""
    choice = list(allowed)
    if not choice:
        return "leave it out"
    lower = {name.lower(): name for name in choice}
    near = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.6)
    return f"did you mean {lower[near[0]]!r}?" if near else f"use one of {', '.join(choice)}"


def key_path(parts: Iterable[str | int]) -> str:
    """``("modes", 0, "damping")`` as ``modes[1].damping``: tables are counted from one."""
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        else:
            text += ("." if text else "") + (part if part.isprintable() else repr(part))
    return text


def _one_line(
    error: ValidationError, schema: type[BaseModel], path: str | Path, inside: str
) -> DeclarationError:
    faults = sorted(
        error.errors(include_url=False),
        key=lambda fault: _ORDER.index(fault["type"]) if fault["type"] in _ORDER else len(_ORDER),
    )
    fault = faults[0]
    kind, location = fault["type"], fault["loc"]
    if len(location) > 1 and location[-1] in _KINDS:
        location = location[:-1]
    key = key_path((inside, *location) if inside else location)
    where = f"{path}, key {key}"
    if kind == "extra_forbidden":
        table = _schema_at(schema, location[:-1])
        return DeclarationError(
            "there is no such key", where=where, remedy=closest(str(location[-1]), _keys(table))
        )
    if kind == "missing":
        missing = [
            key_path((inside, *other["loc"]) if inside else other["loc"])
            for other in faults
            if other["type"] == "missing"
        ]
        word = "key" if len(missing) == 1 else "keys"
        return DeclarationError(
            f"{word} missing: {', '.join(missing)}",
            where=str(path),
            remedy="add " + ("it" if len(missing) == 1 else "them"),
        )
    context = fault.get("ctx", {})
    if kind in _LIMITS:
        what, remedy = (
            text.format(**{name: f"{value:g}" for name, value in context.items()})
            for text in _LIMITS[kind]
        )
        return DeclarationError(
            f"value {_shown(fault['input'])} {what}", where=where, remedy=remedy
        )
    if "remedy" in context:
        return DeclarationError(str(context["what"]), where=where, remedy=str(context["remedy"]))
    if kind == "too_short":
        held, least = len(fault["input"]), int(context.get("min_length", 1))
        if held:
            return DeclarationError(
                f"{held} of at least {least} entries", where=where, remedy=f"give {least} or more"
            )
        return DeclarationError(
            "there is nothing in it",
            where=where,
            remedy=f"give at least {'one entry' if least == 1 else f'{least} entries'}",
        )
    if kind == "too_long":
        most = int(context["max_length"])
        return DeclarationError(
            f"{len(fault['input'])} entries", where=where, remedy=f"give {most} at most"
        )
    message = fault["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return DeclarationError(
        f"value {_shown(fault['input'])} is not {message}", where=where, remedy="correct the value"
    )


def _shown(value: object) -> str:
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _keys(schema: type[BaseModel] | None) -> list[str]:
    return (
        [field.alias or name for name, field in schema.model_fields.items()]
        if schema is not None
        else []
    )


def _schema_at(schema: type[BaseModel], location: Iterable[str | int]) -> type[BaseModel] | None:
    """Return the schema of the table at a location, through nested tables."""
    from pydantic import BaseModel

    table: type[BaseModel] | None = schema
    for part in location:
        fields = (
            {field.alias or name: field for name, field in table.model_fields.items()}
            if table is not None
            else {}
        )
        field = fields.get(str(part))
        options = (
            [] if field is None else [field.annotation, *getattr(field.annotation, "__args__", ())]
        )
        table = next(
            (
                option
                for option in options
                if isinstance(option, type) and issubclass(option, BaseModel)
            ),
            None,
        )
    return table


# ---- Python files of users

WANTED = "a Python file"
# Prefix of modules from users' files, by which tracebacks are recognised.
MODULE = "flightid_of_user_"


def run_python(source: Source, kind: str) -> ModuleType:
    """Run a user's Python file and return its module; ``kind``: part of its name, ``"effects"``.

    Raises
    ------
    DeclarationError : it is no Python file, or anything in it fails, with its line.
    """
    path, where = source.path, str(source.path)
    if path.suffix != ".py":
        raise DeclarationError(
            "this is no Python file", where=where, remedy="name a file that ends in .py"
        )
    name = f"{MODULE}{kind}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their own module up
    try:
        # these bytes were hashed
        exec(compile(source.content, where, "exec", dont_inherit=True), module.__dict__)
    except FlightidError as error:
        inside = f"{error.where}: " if error.where else ""
        raise DeclarationError(
            f"{inside}{error.what}", where=f"{where}{_line(error, path)}", remedy=error.remedy
        ) from None
    except BaseException as error:  # the file is a user's, and anything may be wrong with it
        if not raised_by(error, where):
            raise
        line = (
            f", line {error.lineno}"
            if isinstance(error, SyntaxError) and error.lineno
            else _line(error, path)
        )
        text = error.msg if isinstance(error, SyntaxError) else str(error)
        what = " ".join(f"{type(error).__name__}: {text}".split())
        raise DeclarationError(what, where=f"{where}{line}", remedy="mend that line") from None
    finally:
        sys.modules.pop(name, None)
    return module


def _line(error: BaseException, path: Path) -> str:
    """Return the line of the user's file that the error came through last."""
    result, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            result = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return result


TIME = "time"


STICK = "stick"


# Channel -> unit inside; the stick is never converted, its unit is a label.
CHANNEL_UNITS: Mapping[str, str] = MappingProxyType(
    {
        TIME: "s",
        "elevator": "rad",
        STICK: "1",
        "alpha": "rad",
        "q": "rad/s",
        "nz": "g",
        "altitude": "m",
        "height": "m",
        "aileron": "rad",
        "rudder": "rad",
        "thrust": "N",
        "roll_command": "1",
        "pitch_command": "1",
        "yaw_command": "1",
        "thrust_command": "1",
        "beta": "rad",
        "p": "rad/s",
        "r": "rad/s",
        "phi": "rad",
        "psi": "rad",
        "ny": "g",
        "nx": "g",
        "theta": "rad",
        "airspeed": "m/s",
        "dynamic_pressure": "Pa",
        "ax": "m/s2",
        "ay": "m/s2",
        "az": "m/s2",
    }
)

CLOCK_NAMES = (
    "time", "t", "timestamp", "timeus", "timems", "timens", "time_us", "time_ms", "time_ns", "time_s", "timestamp_us", "timestamp_ms",  # noqa: E501
    "timestamp_ns", "elapsed", "elapsed time", "elapsed_time", "seconds", "sec", "utc", "utc time", "utc_time", "datetime", "date_time",  # noqa: E501
    "date", "gps_time", "tout", "irig", "irig time", "irig_time", "zeit",
    "time_boot_ms", "x_value",
)  # fmt: skip
# an element of an array, as q[0]; of q[1] the unit may be 1
_ELEMENT = re.compile(r"\w+\[(0|[2-9]|\d\d+)\]")
_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")


def split_header(cell: str) -> tuple[str, str | None]:
    """Name and unit of ``name [unit]`` or ``name (unit)``; the unit is None without brackets."""
    match = _BRACKETS.fullmatch(cell)
    if match is None or not match[1] or _ELEMENT.fullmatch(cell):
        return cell, None
    return match[1], (match[2] if match[2] is not None else match[3]).strip()


def is_clock(name: str) -> bool:
    """Return whether a header names a clock, in whatever case and with any unit in brackets."""
    label = re.sub(r"\s*[\[(].*", "", name).strip().lower()
    return label in CLOCK_NAMES or label.replace(" ", "_") in CLOCK_NAMES


@dataclass(frozen=True)
class ColumnChoice:
    """Column of a channel in a file, and the computation from it.

    Attributes
    ----------
    column : header of the column, with or without its unit in brackets; its number, counted from 1;
        or an expression over columns (``scenarios.files.measured.expressions``). In a log of
        several topics ``topic.field``. Empty: the record has no such channel, whatever its columns
        are called.
    unit : unit of the column or of the expression's result; None leaves it to the header, or to the
        units of the columns.
    scale, offset : the channel is ``scale * column + offset``, in ``unit``, in SI where none is
        given.
    delay : s; the channel at ``t`` is the column at ``t + delay``.
    table : calibration ``(x1, ...), (y1, ...)``: the channel is linear between the points, in
        ``unit``; before ``scale``.
    hold : ``"previous"`` or ``"linear"``, between samples of a slower column; None: by the data.
    """

    column: str | int
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    hold: str | None = None

    @property
    def absent(self) -> bool:
        """Whether the channel is not to be read."""
        return self.column == ""

    @property
    def computed(self) -> bool:
        """Whether anything but the column's own numbers is wanted."""
        return (self.scale, self.offset, self.delay, self.table) != (1.0, 0.0, 0.0, None)


def read_channel_map(
    path: str | Path | Mapping[str, Any],
    allowed: Iterable[str] = CHANNEL_UNITS,
    *,
    surfaces: bool = False,
) -> dict[str, ColumnChoice]:
    """Channel name -> column, from a TOML file or as a mapping.

    Lines are such as ``alpha = "AoA1"``, ``alpha = {column = "AoA1", unit = "deg"}``, ``q = {column
    = 4, unit = "deg/s"}``, ``elevator = {column = "0.5*(elevon_left + elevon_right)", unit =
    "deg"}`` or ``elevator = {sum = ["a", "b"], scale = 0.5}``; with ``airspeed = false`` the record
    counts as one without that channel.

    ``allowed``: channels of the model. Further usual channels may be in the map, as in a draft that
    ``flightid map`` wrote. ``surfaces``: so may surfaces of any name, as in a map for the
    model ``aircraft``.

    Raises
    ------
    DeclarationError : the file cannot be read, or a channel or key is unknown, missing or of the
        wrong kind.
    """
    from scenarios.files.schemas import channel_map

    own = tuple(allowed)
    names = tuple(dict.fromkeys((*own, *CHANNEL_UNITS)))
    content, where = (path, "channels") if isinstance(path, Mapping) else (read_toml(path), path)
    further = [key for key in content if key not in names]
    if surfaces:
        names += tuple(key for key in further if _may_be_surface(key, names))
    unknown = next((key for key in further if key not in names), None)
    if unknown is not None:
        raise DeclarationError(
            "there is no such key",
            where=f"{where}, key {key_path([unknown])}",
            remedy=closest(unknown, own),
        )
    schema = channel_map(names)
    chosen = checked(schema, content, where)
    entries = {
        field.alias or name: getattr(chosen, name) for name, field in schema.model_fields.items()
    }
    return {name: _choice(entry) for name, entry in entries.items() if entry is not None}


def _may_be_surface(key: str, known: Iterable[str]) -> bool:
    """Whether a key of a channel map names a surface rather than a channel that is misspelt."""
    if any(key.startswith(f"{name}_") or key.endswith(f"_{name}") for name in known):
        return True
    return not difflib.get_close_matches(key.lower(), list(known), n=1, cutoff=0.8)


def _choice(entry: ColumnEntry) -> ColumnChoice:
    """Return the entry for the reader: ``bias`` is subtracted, ``sign`` multiplies the scale."""
    from scenarios.files.schemas import ABSENT

    if entry.column == ABSENT:
        return ColumnChoice("")
    column = entry.column if entry.sum is None else " + ".join(f"`{name}`" for name in entry.sum)
    assert column is not None
    table = None if entry.table is None else (tuple(entry.table[0]), tuple(entry.table[1]))
    return ColumnChoice(
        column,
        entry.unit,
        entry.sign * entry.scale,
        entry.offset - (entry.bias or 0.0),
        entry.delay,
        table,
        entry.hold,
    )


def of_terms(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the content of a vehicle file of the model ``aircraft``, which has terms. Raises
    DeclarationError for one of another model, which has derivatives.
    """
    if "derivatives" in content and not {"aerodynamics", "surfaces", "model"} & {*content}:
        raise DeclarationError(
            "it has [derivatives], so it is a vehicle file of another model",
            where=str(path),
            remedy="write one of model aircraft: span, three inertias, [surfaces] and [thrust] "
            "(docs/six-degrees.md)",
        )
    return content
