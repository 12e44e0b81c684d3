"""Users' TOML and Python files: every fault becomes one line that names file, key and remedy."""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from scenarios.files.sources import DocumentError, Source, read_source, toml_value
from sim.errors import DeclarationError, FlightidError, raised_by

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError


# ---- Users' TOML files against a pydantic schema

Schema = TypeVar("Schema", bound="BaseModel")

_LIMITS = {
    "greater_than": ("is not above {gt}", "give a value above {gt}"),
    "greater_than_equal": ("is below {ge}", "give {ge} or more"),
    "less_than": ("is not below {lt}", "give a value below {lt}"),
    "less_than_equal": ("is above {le}", "give {le} or less"),
    "finite_number": ("is not a finite number", "give a finite number"),
}
# What to speak of first: a misspelt key is both unknown and missing.
_ORDER = ("extra_forbidden", "missing")
# of a value that may be several: pydantic puts them behind the key
_KINDS = ("float", "int", "str", "constrained-str")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The content of a TOML file. Raises DeclarationError where it is missing, unreadable, or as
    ``toml_of`` says.
    """
    return toml_of(read_toml_source(path))


def read_toml_source(path: str | Path | Source) -> Source:
    """A TOML file as it stands, or as it was read before. Raises DeclarationError where it is
    missing or unreadable.
    """
    if isinstance(path, Source):
        return path
    return read_source(path, DeclarationError, "a TOML file")


def toml_of(source: Source) -> dict[str, Any]:
    """The content of a TOML file that was read.

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
    """The content as an instance of a schema; ``inside`` is the table it stands in, e.g.
    ``"modes[1]"``.

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


def closest(word: str, known: Iterable[str]) -> str:
    """``"did you mean 'alpha'?"``, or the whole choice where nothing is near."""
    choice = list(known)
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
    """The schema of the table at a location, followed through fields that are tables themselves."""
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
# begins the name of every module that a user's file makes: tracebacks show by it whose code failed
MODULE = "flightid_of_user_"


def run_python(source: Source, kind: str) -> ModuleType:
    """The module that a file makes, run as any Python program is; ``kind`` is part of its name
    while it runs, ``"effects"``.

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
    """The line of the user's file that the error came through last."""
    found, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            found = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return found
