"""Tables of results and libraries as text, HTML and DataFrame; errors and keywords of Python.

Error messages name Python keywords instead of command-line options.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from scenarios.report.summary import columns_of, table_lines, wrapped
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    import pandas

    from scenarios.report import document
    from sim.declaration.model import Equations

P = ParamSpec("P")
R = TypeVar("R")
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")
# An option with its value, a word, and a command with the files and options after it.
_WITH_VALUE = re.compile(r"(?<![\w-])--(method|hold|margins) ([a-z-]+)")
# An option whose value is a pair, NAME=VALUE, which is a mapping in Python.
_OF_PAIR = re.compile(r"(?<![\w-])--(fix|fit) ([A-Za-z][\w.]*)=([\w./-]*\w)")
_COMMAND = re.compile(
    r"\bflightid ([a-z]+)"
    r"((?: (?:--(?!method|hold)[a-z-]+ [^\s;,]+|[A-Z]{3,}|[^\s;,]+\.[A-Za-z]\w*))*)"
)
WORDS = {  # Option -> keyword with another name: reserved words and plurals.
    "from": "start",
    "to": "stop",
    "class": "aircraft_class",
    "out": "save(folder)",
    "value": "values",
}


def as_keywords(text: str, arguments: Collection[str] = ()) -> str:
    """Return a message with keywords in place of options.

    Parameters
    ----------
    text : the message.
    arguments : arguments of the function; an option with the name of one keeps it.

    Examples
    --------
    >>> as_keywords("use --from and --trust-record")
    'use start= and trust_record='
    """

    def keyword(found: re.Match[str]) -> str:
        name = (
            found[1] if found[1] in arguments else WORDS.get(found[1], found[1].replace("-", "_"))
        )
        return name if name.endswith(")") else f"{name}="

    def mapping(found: re.Match[str]) -> str:
        shown = found[3] if re.fullmatch(r"-?[\d.]+|VALUE", found[3]) else f'"{found[3]}"'
        return f'{found[1]}={{"{found[2]}": {shown}}}'

    text = _OF_PAIR.sub(mapping, text)
    return _OPTION.sub(keyword, _WITH_VALUE.sub(r'\1="\2"', text))


def in_python_words(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return sentences with functions and keywords in place of commands and options.

    Examples
    --------
    >>> in_python_words(["next: flightid diagnose f.csv --model rigid --vehicle v.toml"])
    ('next: flightid.diagnose on the same records',)
    """

    def call(found: re.Match[str]) -> str:
        given = " on the same records" if found[2] else ""
        return f"flightid.{found[1].replace('response', 'frequency_response')}{given}"

    texts = (as_keywords(_COMMAND.sub(call, sentence)) for sentence in sentences)
    return tuple(text.replace(" records method=", " records with method=") for text in texts)


@contextlib.contextmanager
def in_python(arguments: Collection[str] = ()) -> Iterator[None]:
    """Context manager that replaces options by keywords in messages of errors.

    ``arguments``: arguments of the function.
    """
    try:
        yield
    except FlightidError as error:
        given = (error.what, error.where, error.remedy)
        what, where, remedy = (as_keywords(part, arguments) for part in given)
        if (what, where, remedy) == given:
            raise
        raise type(error)(what, where=where, remedy=remedy) from None


def with_python_errors(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function whose error messages name keywords instead of options.

    Arguments are checked by their annotations before the function is called.
    """
    signature = inspect.signature(function)
    declared = {name: str(item.annotation) for name, item in signature.parameters.items()}

    @functools.wraps(function)
    def wrapped_function(*args: P.args, **kwargs: P.kwargs) -> R:
        with in_python(declared):
            # Unknown and surplus arguments are left to Python.
            given = {**dict(zip(declared, args, strict=False)), **kwargs}
            for name in given.keys() & declared.keys():
                refuse_wrong_type(name, given[name], declared[name])
            return function(*args, **kwargs)

    return wrapped_function


def refuse_wrong_type(name: str, value: Any, declared: str) -> None:
    """Raise DeclarationError for a value that is not of the declared kind.

    Parameters
    ----------
    name, value : the argument.
    declared : its annotation. Truth values, numbers, counts, seeds, texts, tables and functions are
        checked; other types are left to the function.
    """
    kinds = [kind.strip() for kind in declared.split("|")]
    if value is None and "None" in kinds:
        return
    what = remedy = ""
    if kinds == ["bool"] and not isinstance(value, bool | np.bool_):
        what, remedy = "neither True nor False", "give True or False"
    elif kinds[0] == "int" and (not _is_number(value, Integral) or value < 0):
        what = "no seed" if name == "seed" else "no count"
        remedy = "give a whole number, zero or more"
    elif kinds in (["float"], ["float", "None"]) and not _is_number(value, Real):
        what, remedy = "no number", "give a number"
    elif kinds in (["str"], ["str", "None"]) and not isinstance(value, str):
        what, remedy = "no text", "give a text"
    elif kinds[0].startswith("Mapping") and not isinstance(value, Mapping):
        what, remedy = "no table", "give values by name, in braces"
    elif kinds[0].startswith("Callable") and not callable(value):
        what, remedy = "no function", "give a function"
    if what:
        raise DeclarationError(f"{value!r:.60} is {what}", where=name, remedy=remedy)


def _is_number(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool | np.bool_)


def names_of(
    given: str | Sequence[str], kind: str = "signal", where: str = "input, output"
) -> tuple[str, ...]:
    """Return one name or several of a ``kind``. Raises DeclarationError for other types."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        remedy = "give a name or a list of names"
        raise DeclarationError(f"{given!r} names no {kind}", where=where, remedy=remedy)
    return tuple(names)


def band_of(given: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return lowest and highest frequency, Hz. Raises DeclarationError if they are no numbers."""
    if given is None:
        return None
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        remedy = "give the lowest and the highest frequency, Hz: (0.1, 8)"
        raise DeclarationError(f"{given!r} is no band", where="band", remedy=remedy) from None
    return low, high


# ---- The exception for wrong input

# Its text is the line that a command prints; `what`, `where` and `remedy` are its parts.
InputError = FlightidError


# ---- Results as HTML, for notebooks


def page(heading: str, *parts: str) -> str:
    """Return a heading in bold, then the parts that are not empty."""
    lines = ["<div>", f"<p><strong>{escape(heading)}</strong></p>", *filter(None, parts), "</div>"]
    return "\n".join(lines)


def sentences(lines: Sequence[str]) -> str:
    """Return a list of sentences; nothing if there is none."""
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>" if lines else ""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table, empty without rows; the first ``left`` columns are left-aligned."""
    sides = ["left" if i < left else "right" for i in range(len(headings))]
    return _table(headings, rows, sides)


def of_document(shown: document.Table) -> str:
    """Return a table of a report, with units and sigmas in separate columns."""
    from scenarios.report.terminal import printed_columns

    columns = printed_columns(shown)
    rows = list(zip(*(column.cells for column in columns), strict=True))
    sides = ["left" if column.left else "right" for column in columns]
    return _table([column.heading.strip() for column in columns], rows, sides)


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], sides: Sequence[str]) -> str:
    if not rows:
        return ""

    def line(cells: Sequence[str], tag: str) -> str:
        aligned = (
            f'<{tag} style="text-align:{side};padding:0 0.6em">{escape(cell)}</{tag}>'
            for cell, side in zip(cells, sides, strict=True)
        )
        return f"<tr>{''.join(aligned)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<table><thead>{line(headings, 'th')}</thead><tbody>{body}</tbody></table>"


# ---- A small table of texts and numbers for terminal, notebook and pandas

MOST_CELL_LETTERS = 60  # letters of a cell in a terminal


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Rows under headings; the first column names them.

    ``len``, iteration over rows as dictionaries, ``table[name]`` for the row of that name,
    ``names``.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The first column."""
        return tuple(str(row[0]) for row in self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (dict(zip(self.headings, row, strict=True)) for row in self.rows)

    def __getitem__(self, name: str) -> dict[str, Any]:
        if name not in self.names:
            raise KeyError(f"there is no {name!r}: {', '.join(self.names)}")
        return dict(zip(self.headings, self.rows[self.names.index(name)], strict=True))

    def __repr__(self) -> str:
        return f"<{self.title}: {len(self)} rows of {', '.join(self.headings)}>"

    def __str__(self) -> str:
        cells = [[_shortened(cell) for cell in row] for row in self.rows]
        columns = columns_of(self.headings, cells, left=len(self.headings))
        return "\n".join([*wrapped(self.title), *table_lines(columns)])

    def _repr_html_(self) -> str:
        cells = [[_text(cell) for cell in row] for row in self.rows]
        return page(self.title, table(self.headings, cells, left=len(self.headings)))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a DataFrame with the first column as its index."""
        import pandas

        frame = pandas.DataFrame(list(self.rows), columns=list(self.headings))
        return frame.set_index(self.headings[0])


def _text(cell: Any) -> str:
    if isinstance(cell, float):
        return f"{cell:.6g}"
    return ", ".join(map(str, cell)) if isinstance(cell, tuple | list) else str(cell)


def _shortened(cell: Any) -> str:
    text = _text(cell)
    return (
        text if len(text) <= MOST_CELL_LETTERS else text[: MOST_CELL_LETTERS - 4].rstrip() + " ..."
    )


# ---- Effects, models, vehicles and scenarios as tables

TITLES = {
    "ballistic": "a falling body: altitude from drag in an atmosphere that thins out",
    "rigid": "the short period of a rigid aircraft: alpha and q from elevator",
    "flexible": "the short period with elastic modes",
    "loes": "low-order equivalent system: alpha, q from the stick, a delay",
    "lateral": "sideslip, roll and yaw from aileron and rudder",
    "longitudinal": "airspeed, alpha, attitude and q from elevator and thrust",
    "multirotor": "roll, pitch and yaw rates and az from commands to the motors",
    "aircraft": "six degrees of freedom, with the terms of a vehicle file",
}


def effects() -> Table:
    """Return the library of effects: name, station, explanation, parameters.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.effects()["input-delay"]["station"]
    'input path'
    """
    from sim.effects.library import effect_names, find_effect

    rows = []
    for name in effect_names():
        effect = find_effect(name)
        explanation = " ".join(effect.explanation.split())
        parameters = tuple(f"{item.name} ({item.unit})" for item in effect.parameters)
        rows.append((name, effect.station.value, explanation, parameters))
    return Table("effects", ("effect", "station", "explanation", "parameters"), tuple(rows))


def model_family(name: str) -> tuple[Equations, Mapping[str, str], Mapping[str, str]]:
    """Return the equations of a built-in model, and the units of its constants and parameters.

    Those of ``aircraft`` depend on the file; here they are those of a generic airliner.
    """
    from scenarios.files.aircraft_files import example
    from scenarios.files.vehicles import AIRCRAFT
    from sim.vehicles.factory import FAMILIES

    if name != AIRCRAFT:
        return FAMILIES[name]
    model = example()
    constants, parameters = (
        {item.name: item.unit for item in model.parameters if item.free is free}
        for free in (False, True)
    )
    return model.equations, constants, parameters


def models() -> Table:
    """Return the models: name, description, inputs, outputs, constants and parameters.

    A vehicle file gives the constants, and the parameters are estimated. Those of ``aircraft``
    depend on the file; here they are those of a generic airliner.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.models()["rigid"]["inputs"]
    ('elevator',)
    """
    from scenarios.files.vehicles import MODELS

    rows = []
    for name in MODELS:
        # The flexible model has the signals of the rigid one, and its modes are of any number.
        equations, constants, derivatives = model_family("rigid" if name == "flexible" else name)
        signals = (
            tuple(signal.name for signal in group)
            for group in (equations.inputs, equations.outputs)
        )
        rows.append((name, TITLES[name], *signals, tuple(constants), tuple(derivatives)))
    return Table(
        "models",
        ("model", "what it is", "inputs", "outputs", "constants", "parameters"),
        tuple(rows),
    )


def vehicles() -> Table:
    """Return the library of vehicles: name, description, equations, source of the numbers.

    Examples
    --------
    >>> import flightid as fid
    >>> "navion_lateral" in fid.vehicles().names
    True
    """
    from sim.vehicles.library import read_parameter_set, vehicle_names

    sets = [read_parameter_set(name) for name in vehicle_names()]
    rows = tuple((item.name, item.title, item.equations, item.source) for item in sets)
    return Table("vehicles", ("vehicle", "what it is", "equations", "source"), rows)


def scenarios() -> Table:
    """Return the catalogue of scenarios: name, kind, title.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.scenarios()["rigid"]["title"]
    'rigid aircraft: six derivatives from a 3-2-1-1'
    """
    from scenarios.studies.catalogue import scenario_kind, scenario_names, scenario_title

    return Table(
        "scenarios",
        ("scenario", "kind", "title"),
        tuple((name, scenario_kind(name), scenario_title(name)) for name in scenario_names()),
    )
