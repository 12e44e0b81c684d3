"""Reading of users' TOML and Python files, and channel maps.

Every error states file, key and remedy in one line. A channel map assigns columns of a file to the
channels that a record may have.
"""

from __future__ import annotations

import ast
import contextlib
import difflib
import importlib.util
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
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
# Errors that are reported before others. A misspelt key causes an unknown and a missing key: the
# unknown one is reported.
_FIRST_ERRORS = ("extra_forbidden", "missing")
# If a value may have several types, pydantic appends the type to the location of an error.
_TYPES_IN_LOCATIONS = ("float", "int", "str", "constrained-str")
_LONGEST_SHOWN = 40  # letters of a value in a message


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises DeclarationError if the file is missing or cannot be read, and as ``toml_of``.
    """
    return toml_of(read_toml_source(path))


def read_toml_source(path: str | Path | Source) -> Source:
    """Return the source of a TOML file. An open file is returned as it is.

    Raises DeclarationError if the file is missing or unreadable.
    """
    if isinstance(path, Source):
        return path
    return read_source(path, DeclarationError, "a TOML file")


def toml_of(source: Source) -> dict[str, Any]:
    """Return the content of an open TOML file.

    Raises
    ------
    DeclarationError : if the file is not UTF-8 or not TOML, with line and column, or if
        ``toml_value`` refuses its content.
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
    """Add the name of the file to errors of the body that do not have it."""
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
    """Return the content as an instance of a schema.

    ``inside`` is the table that has the content, such as ``"modes[1]"``, for messages.

    Raises
    ------
    DeclarationError : if the content does not agree with the schema. The message has the first
        unknown key, else all missing keys, else the first wrong value.
    """
    from pydantic import ValidationError

    try:
        return schema.model_validate(dict(content))
    except ValidationError as error:
        raise _one_line(error, schema, path, inside) from None


def closest(word: str, allowed: Iterable[str]) -> str:
    """Return a remedy for a wrong word: ``"did you mean 'alpha'?"``, or all allowed words if none
    is similar.
    """
    choices = list(allowed)
    if not choices:
        return "leave it out"
    by_lower_case = {name.lower(): name for name in choices}
    near = difflib.get_close_matches(word.lower(), by_lower_case, n=1, cutoff=0.6)
    if near:
        return f"did you mean {by_lower_case[near[0]]!r}?"
    return f"use one of {', '.join(choices)}"


def refuse_unknown(
    kind: str,
    name: str,
    known: Collection[str],
    where: str,
    error: type[FlightidError] = DeclarationError,
) -> None:
    """Raise an ``error`` for a name that is not one of the ``known`` names of a ``kind``."""
    if name not in known:
        raise error(f"there is no {kind} {name!r}", where=where, remedy=closest(str(name), known))


def shortened_list(words: Sequence[str], most: int) -> str:
    """Return the first ``most`` words, separated by commas, and ``...`` in place of the others."""
    return ", ".join(words[:most]) + (", ..." if len(words) > most else "")


def key_path(parts: Iterable[str | int]) -> str:
    """Return the text of a key: ``("modes", 0, "damping")`` is ``modes[1].damping``.

    Tables count from zero in ``parts`` and from one in the text.
    """
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
    """Return the errors of pydantic as the error of ``checked``."""
    faults = sorted(
        error.errors(include_url=False),
        key=lambda fault: (*_FIRST_ERRORS, fault["type"]).index(fault["type"]),
    )
    fault = faults[0]
    kind, location = fault["type"], fault["loc"]
    if len(location) > 1 and location[-1] in _TYPES_IN_LOCATIONS:
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
            key_path((inside, *missing_fault["loc"]) if inside else missing_fault["loc"])
            for missing_fault in faults
            if missing_fault["type"] == "missing"
        ]
        word, pronoun = ("key", "it") if len(missing) == 1 else ("keys", "them")
        what = f"{word} missing: {', '.join(missing)}"
        return DeclarationError(what, where=str(path), remedy=f"add {pronoun}")
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
        count, least = len(fault["input"]), int(context.get("min_length", 1))
        if count:
            what = f"{count} of at least {least} entries"
            return DeclarationError(what, where=where, remedy=f"give {least} or more")
        entries = "one entry" if least == 1 else f"{least} entries"
        remedy = f"give at least {entries}"
        return DeclarationError("there is nothing in it", where=where, remedy=remedy)
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
    """Return a value as a short text for messages."""
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 3] + "..."


def _keys(schema: type[BaseModel] | None) -> list[str]:
    if schema is None:
        return []
    return [field.alias or name for name, field in schema.model_fields.items()]


def _schema_at(schema: type[BaseModel], location: Iterable[str | int]) -> type[BaseModel] | None:
    """Return the schema of the table at a location in nested tables; None if there is none."""
    from pydantic import BaseModel

    table: type[BaseModel] | None = schema
    for part in location:
        if table is None:
            return None
        fields = {field.alias or name: field for name, field in table.model_fields.items()}
        field = fields.get(str(part))
        if field is None:
            return None
        types = [field.annotation, *getattr(field.annotation, "__args__", ())]
        schemas = (kind for kind in types if isinstance(kind, type) and issubclass(kind, BaseModel))
        table = next(schemas, None)
    return table


# ---- Python files of users

WANTED = "a Python file"
# prefix of the names of modules from users' files, which identifies them in tracebacks
MODULE = "flightid_of_user_"


def run_python(source: Source, kind: str) -> ModuleType:
    """Run a user's Python file and return its module.

    ``kind`` is what the file declares, such as ``"effects"``. It is a part of the name of the
    module.

    Raises
    ------
    DeclarationError : if the file is no Python file, or if an exception occurs in it; the message
        has the line.
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
    sys.modules[name] = module  # a dataclass needs its module there
    try:
        # These bytes were hashed; the file itself may have changed.
        exec(compile(source.content, where, "exec", dont_inherit=True), module.__dict__)
    except FlightidError as error:
        inside = f"{error.where}: " if error.where else ""
        raise DeclarationError(
            f"{inside}{error.what}", where=f"{where}{_line(error, path)}", remedy=error.remedy
        ) from None
    except BaseException as error:  # a user's file may raise anything
        if not raised_by(error, where):
            raise
        line, text = _line(error, path), str(error)
        if isinstance(error, SyntaxError):
            text = error.msg
            if error.lineno:
                line = f", line {error.lineno}"
        what, remedy = " ".join(f"{type(error).__name__}: {text}".split()), "mend that line"
        if isinstance(error, AttributeError) and isinstance(error.obj, type | ModuleType):
            what = f"{error.obj.__name__} has no attribute {error.name!r}"
            remedy = present_name(str(error.name), dir(error.obj)) or remedy
        raise DeclarationError(what, where=f"{where}{line}", remedy=remedy) from None
    finally:
        sys.modules.pop(name, None)
    return module


def _line(error: BaseException, path: Path) -> str:
    """Return the innermost line of the user's file in the traceback of an error, for messages."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return line


# Names that files written for version 0.2.0 use -> names in their place.
PRESENT_NAMES = {"rank": "path_order", "UNDEFINED": "UNIDENTIFIED_AT_ABSENCE"}
# Attributes of effects that no protocol declares: of single functions, and of the older form.
_FURTHER_ATTRIBUTES = (
    *("attitude_recorded", "commutes", "control", "label", "rename", "shared", "unit"),
    *("onset", "per_record", "plausible", "sentence"),
)


def present_name(name: str, known: Iterable[str]) -> str:
    """Return a remedy that gives the known name meant by an unknown one; empty if none is near."""
    names = {word for word in known if not word.startswith("_")}
    if PRESENT_NAMES.get(name) in names:
        return f"its present name is {PRESENT_NAMES[name]!r}"
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else ""


def refuse_unknown_attributes(effect: object, content: bytes | None, where: str) -> None:
    """Raise DeclarationError for an attribute of a user's effect that nothing reads.

    An attribute is known if a protocol of effects has it, if a class of this program declares it,
    or if the user's own file reads it.

    Parameters
    ----------
    effect : an object with a ``name``.
    content : the user's file; None for an effect without a file, of which only attributes in
        ``PRESENT_NAMES`` are refused.
    where : name of the file in the message.
    """
    from sim.declaration import effect as effects
    from sim.declaration import proposal

    classes = [kind for kind in type(effect).__mro__ if kind is not object]
    ours = [kind for kind in classes if kind.__module__.partition(".")[0] == "sim"]
    protocols = [
        kind
        for module in (effects, proposal)
        for kind in vars(module).values()
        if getattr(kind, "_is_protocol", False)
    ]
    known = {
        *(name for kind in (*ours, *protocols) for name in dir(kind)),
        *(name for kind in ours for name in vars(kind).get("__annotations__", ())),
        *_FURTHER_ATTRIBUTES,
    }
    nodes = [*ast.walk(ast.parse(content))] if content is not None else []
    read = {
        *(node.attr for node in nodes if isinstance(node, ast.Attribute)),
        *(n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)),
        *(node.value for node in nodes if isinstance(node, ast.Constant)),
    }
    declared = dict.fromkeys(
        name
        for table in (*map(vars, classes), getattr(effect, "__dict__", {}))
        for name in table
        if not name.startswith("_")
    )
    for name in declared:
        former = PRESENT_NAMES.get(name)
        unknown = name not in known | read if content is not None else former is not None
        if unknown or (former is not None and not hasattr(effect, former)):
            raise DeclarationError(
                f"effect {getattr(effect, 'name', '')}: unknown attribute {name!r}",
                where=where,
                remedy=present_name(name, known) or "leave it out, nothing reads it",
            )


# ---- Channels and channel maps

TIME = "time"
STICK = "stick"
# Channel -> SI unit. The stick is never converted; its unit is a label.
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
# An element of an array such as q[0]. q[1] is left out: it may be q in the unit 1.
_ELEMENT = re.compile(r"\w+\[(0|[2-9]|\d\d+)\]")
_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")


def split_header(cell: str) -> tuple[str, str | None]:
    """Return name and unit of a header ``name [unit]`` or ``name (unit)``; without brackets the
    unit is None.
    """
    match = _BRACKETS.fullmatch(cell)
    if match is None or not match[1] or _ELEMENT.fullmatch(cell):
        return cell, None
    return match[1], (match[2] if match[2] is not None else match[3]).strip()


def is_clock(name: str) -> bool:
    """Return whether a header names a clock; letter case and a unit in brackets do not matter."""
    label = re.sub(r"\s*[\[(].*", "", name).strip().lower()
    return label in CLOCK_NAMES or label.replace(" ", "_") in CLOCK_NAMES


@dataclass(frozen=True)
class ColumnChoice:
    """Column of a channel in a file, and how the channel is computed from it.

    Attributes
    ----------
    column : header of the column, with or without its unit in brackets; in a log of several topics
        ``topic.field``. Or the number of the column, counted from 1, or an expression over columns
        (``scenarios.files.measured.expressions``). Empty: the channel is not read.
    unit : unit of the column or of the expression; None takes the unit in the file.
    scale : factor of the column: the channel is ``scale * column + offset``.
    offset : see ``scale``; in ``unit``, or in SI units if ``unit`` is None.
    delay : s; the channel at ``t`` is the column at ``t + delay``.
    table : calibration ``(x1, ...), (y1, ...)``, linear between its points, in ``unit``; it is
        applied before ``scale`` and ``offset``.
    hold : ``"previous"`` or ``"linear"``, for an input between the samples of a slower column; None
        takes that which the data suggest.
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
        """Whether the map declares that the record does not have the channel."""
        return self.column == ""

    @property
    def computed(self) -> bool:
        """Whether the channel differs from the numbers of its column."""
        return (self.scale, self.offset, self.delay, self.table) != (1.0, 0.0, 0.0, None)


def read_channel_map(
    path: str | Path | Mapping[str, Any],
    allowed: Iterable[str] = CHANNEL_UNITS,
    *,
    surfaces: bool = False,
) -> dict[str, ColumnChoice]:
    """Return the column of each channel in a channel map.

    Examples of lines::

        alpha = "AoA1"
        alpha = {column = "AoA1", unit = "deg"}
        q = {column = 4, unit = "deg/s"}
        elevator = {column = "0.5*(elevon_left + elevon_right)", unit = "deg"}
        elevator = {sum = ["a", "b"], scale = 0.5}
        airspeed = false    # the record has no airspeed

    Parameters
    ----------
    path : a TOML file, or its content.
    allowed : channels of the model. The channels of ``CHANNEL_UNITS`` are always allowed.
    surfaces : whether surfaces of any name are allowed, as for the model ``aircraft``.

    Raises
    ------
    DeclarationError : if the file cannot be read, or if a channel or key is unknown, missing or of
        the wrong kind.
    """
    from scenarios.files.schemas import channel_map

    model_channels = tuple(allowed)
    names = tuple(dict.fromkeys((*model_channels, *CHANNEL_UNITS)))
    content, where = (path, "channels") if isinstance(path, Mapping) else (read_toml(path), path)
    other_keys = [key for key in content if key not in names]
    if surfaces:
        names += tuple(key for key in other_keys if _may_be_surface(key, names))
    unknown = next((key for key in other_keys if key not in names), None)
    if unknown is not None:
        raise DeclarationError(
            "there is no such key",
            where=f"{where}, key {key_path([unknown])}",
            remedy=closest(unknown, model_channels),
        )
    schema = channel_map(names)
    chosen = checked(schema, content, where)
    entries = {
        field.alias or name: getattr(chosen, name) for name, field in schema.model_fields.items()
    }
    return {name: _choice(entry) for name, entry in entries.items() if entry is not None}


def _may_be_surface(key: str, known: Iterable[str]) -> bool:
    """Return whether an unknown key of a channel map is a surface, and no misspelt channel."""
    if any(key.startswith(f"{name}_") or key.endswith(f"_{name}") for name in known):
        return True
    return not difflib.get_close_matches(key.lower(), list(known), n=1, cutoff=0.8)


def _choice(entry: ColumnEntry) -> ColumnChoice:
    """Return the choice of an entry of a channel map. A ``bias`` is subtracted from the offset, and
    a ``sign`` is a factor of the scale.
    """
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
    """Return the content of a vehicle file of the model ``aircraft``, which has terms.

    Raises
    ------
    DeclarationError : for a vehicle file of another model, which has derivatives.
    """
    if "derivatives" in content and not {"aerodynamics", "surfaces", "model"} & {*content}:
        raise DeclarationError(
            "it has [derivatives], so it is a vehicle file of another model",
            where=str(path),
            remedy="write one of model aircraft: span, three inertias, [surfaces] and [thrust] "
            "(docs/six-degrees.md)",
        )
    return content
