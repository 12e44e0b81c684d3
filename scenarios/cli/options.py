"""Options that several commands share, with shell completion and output options.

Some options form a group: those on the preparation of records, and those on output. A command
takes a group as one keyword parameter. `with_groups` turns it into the options of the group.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import io
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, TextIO, cast, get_type_hints

import typer

from scenarios.preparation.plan import Plan, plan_of, with_maneuvers
from scenarios.report.figure_formats import Formats, formats_of

# ---- Shell completion

# Copies of lists in modules that load NumPy, which would slow down help and completion. A test
# compares them.
MODEL_NAMES = (
    "ballistic",
    "rigid",
    "flexible",
    "loes",
    "lateral",
    "longitudinal",
    "multirotor",
    "aircraft",
)
METHOD_WORDS = ("stepwise", "orthogonal")  # of `structure`
TARGETS = ("python", "fmu", "jsbsim", "dave-ml")  # of `export`
TO_HELP = f"{', '.join(TARGETS)}; the last two for the model aircraft only."
METHOD_NAMES = ("output-error", "filter-error", "frequency-domain", "equation-error", "ekf", "ukf")


def scenarios(incomplete: str) -> list[str]:
    """Return the scenarios of the catalogue that begin with ``incomplete``."""
    from scenarios.studies.catalogue import scenario_names

    return _beginning(scenario_names(), incomplete)


def models(incomplete: str) -> list[str]:
    """Return the built-in models that begin with ``incomplete``."""
    return _beginning(MODEL_NAMES, incomplete)


def methods(incomplete: str) -> list[str]:
    """Return the methods of identification that begin with ``incomplete``."""
    return _beginning(METHOD_NAMES, incomplete)


def effects(incomplete: str) -> list[str]:
    """Return the effects of the library that begin with ``incomplete``."""
    from sim.effects.library import effect_names

    return _beginning(effect_names(), incomplete)


def vehicles(incomplete: str) -> list[str]:
    """Return the vehicles of the library that begin with ``incomplete``."""
    from sim.vehicles.library import vehicle_names

    return _beginning(vehicle_names(), incomplete)


def fixed_words(*words: str) -> Callable[[str], list[str]]:
    """Return the completion function of an option that takes one of these words."""

    def complete(incomplete: str) -> list[str]:
        return _beginning(words, incomplete)

    return complete


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


# ---- Options and arguments that several commands share


def valued(
    name: str,
    metavar: str,
    explanation: str,
    complete: Callable[[str], list[str]] | None = None,
    **bounds: Any,
) -> Any:
    """Declare an option with a value.

    Parameters
    ----------
    name : the option, as ``--out``.
    metavar : word for the value in the help.
    explanation : line of help.
    complete : completion function of the shell.
    bounds : ``min`` and ``max`` of a number.
    """
    return typer.Option(name, metavar=metavar, help=explanation, autocompletion=complete, **bounds)


def flag(name: str, explanation: str) -> Any:
    """Declare an option without a value, by its name and line of help."""
    return typer.Option(name, help=explanation)


Out = Annotated[Path | None, valued("--out", "DIR", "Write the study into this folder.")]
Seed = Annotated[
    int | None,
    valued("--seed", "N", "Seed of the random numbers; the scenario's own when left out.", min=0),
]
Changes = Annotated[
    list[str] | None,
    valued("--set", "KEY=VALUE", "Change an entry of the scenario, e.g. flight.rate=50."),
]
From = Annotated[
    list[float] | None,
    valued(
        "--from", "T", "Use the record from this time on, s; with --to, again for each maneuver."
    ),
]
To = Annotated[list[float] | None, valued("--to", "T", "Use the record up to this time, s.")]
Maneuvers = Annotated[
    list[str] | None,
    valued(
        "--maneuver", "N", "Use a maneuver of maneuvers.toml, by number or name; again for each."
    ),
]
ManeuverFile = Annotated[
    Path | None,
    valued("--maneuvers", "FILE", "File of --maneuver; else maneuvers.toml beside the record."),
]
Held = Annotated[
    str | None,
    valued(
        "--hold",
        "HOLD",
        "Inputs between samples: previous or linear; else as the data say.",
        complete=fixed_words("previous", "linear"),
    ),
]
Rate = Annotated[
    float | None,
    valued(
        "--rate",
        "HZ",
        "Resample all channels to this rate after one filter; of a record without a clock: "
        "its rate.",
    ),
]
ClockRate = Annotated[
    float | None,
    valued(
        "--rate",
        "HZ",
        "Of a record without a clock: its rate; of a log of topics: that of their grid.",
    ),
]
Columns = Annotated[
    str | None,
    valued(
        "--columns",
        "NAME,NAME,...",
        "Names of the columns, of a file without a header or instead of its own.",
    ),
]
Lowpass = Annotated[
    float | None,
    valued("--lowpass", "HZ", "One zero-phase low-pass for all channels, inputs included."),
]
Trust = Annotated[
    bool,
    flag(
        "--trust-record",
        "Take the raw columns as they are: warn of what they show, refuse and mask nothing.",
    ),
]
Model = Annotated[
    str,
    valued(
        "--model",
        "M",
        f"{', '.join(MODEL_NAMES)}, or FILE.py with a model of your own.",
        complete=models,
    ),
]
Records = Annotated[
    list[Path],
    typer.Argument(metavar="RECORD...", help="Record files of one vehicle, from any recorder."),
]
VehicleOption = Annotated[
    Path | None,
    valued(
        "--vehicle",
        "V.toml",
        "Constants and starting values; else vehicle.toml beside the first record, if any.",
    ),
]
Scenario = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME", autocompletion=scenarios, help="A scenario; leave it out with --model."
    ),
]
OwnModel = Annotated[
    str | None,
    valued(
        "--model", "FILE.py", "A model of your own flies instead of a scenario; its file is run."
    ),
]
StudyModel = Annotated[
    Path | None, valued("--model", "FILE.py", "The study's own model, which is run.")
]
TrueValues = Annotated[
    Path | None, valued("--vehicle", "V.toml", "With --model: true values; else those of its file.")
]
Inputs = Annotated[
    list[str] | None,
    valued(
        "--input",
        "NAME=KIND,KEY=VALUE,...",
        "With --model, again for each maneuver; else a doublet on each input.",
    ),
]
Noise = Annotated[
    list[str] | None,
    valued(
        "--noise",
        "OUTPUT=SIZE",
        "With --model: standard deviation; else 1 % of its largest change.",
    ),
]
Duration = Annotated[
    float | None, valued("--duration", "S", "With --model: length of the record, s.")
]
SampleRate = Annotated[float | None, valued("--rate", "HZ", "With --model: samples a second.")]
Figures = Annotated[
    list[str] | None,
    valued(
        "--figures",
        "FORMAT,...",
        "Figures as png (usual), svg or pdf, several with commas; or none.",
        complete=fixed_words("png", "svg", "pdf", "none"),
    ),
]
Paper = Annotated[
    str | None,
    valued(
        "--paper",
        "a4|letter",
        "Paper of the PDF; A4 when left out.",
        complete=fixed_words("a4", "letter"),
    ),
]
NoFigures = Annotated[bool, flag("--no-figures", "Draw none, as --figures none.")]
Class = Annotated[
    str | None,
    valued(
        "--class",
        "I..IV",
        "Class of the aircraft, for levels of flying qualities; II-C: carrier.",
        complete=fixed_words("I", "II", "II-C", "III", "IV"),
    ),
]
Category = Annotated[
    str | None,
    valued(
        "--category",
        "A|B|C",
        "Category of the flight phase: A rapid, B gradual, C terminal.",
        complete=fixed_words("A", "B", "C"),
    ),
]
Channels = Annotated[
    Path | None, valued("--channels", "MAP", "TOML file that maps columns to channels.")
]
Quiet = Annotated[bool, flag("--quiet", "Print nothing but errors and warnings.")]
AsJson = Annotated[
    bool, flag("--json", "Print the study's JSON document, as --out writes it, and nothing else.")
]
Jobs = Annotated[
    int | None,
    valued("--jobs", "N", "Number of processes; else one per core. Results do not depend on it."),
]
Resume = Annotated[
    bool,
    flag("--resume", "Continue the runs in the folder of --out; --runs may be larger than before."),
]
Cluster = Annotated[
    str | None,
    valued("--cluster", "ADDRESS", "Work on a Dask cluster, by its scheduler's tcp://HOST:PORT."),
]
TimeLimit = Annotated[
    float | None,
    valued("--time-limit", "S", "Seconds that a run may take; one that takes longer is left out."),
]


# ---- Output of a command: --quiet and --json


@dataclass(frozen=True)
class OutputOptions:
    """Output of a command.

    Attributes
    ----------
    out : folder of the study; None writes nothing.
    figures : formats of the figures.
    progress : whether a progress bar may be shown.
    """

    out: Path | None
    figures: Formats
    progress: bool

    def finish(self, result: Any, write: Callable[..., Any], show: Callable[..., None]) -> None:
        """Write a result into the folder, print it, and print where it was written.

        Parameters
        ----------
        result : result of the command.
        write : function of result, folder and ``figures`` that writes the study; it is not called
            without a folder.
        show : function of ``details``, the place of further results, that prints the result.
        """
        from scenarios.report.summary import details_in

        if self.out is not None:
            write(result, self.out, figures=self.figures)
        show(details=details_in(self.out))
        self.print_place()

    def print_place(self) -> None:
        """Print where the study was written; nothing without a folder."""
        from scenarios.report.summary import written_to

        if self.out is not None:
            print(written_to(self.out))


_COLOURS = re.compile(r"\x1b\[[0-9;]*m")  # escape sequences of a terminal


class _CopyingStream:
    """A stream that passes text on to another stream and stores a copy."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self.copy = stream, io.StringIO()

    def write(self, text: str) -> int:
        self.copy.write(text)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def keeping_text(out: Path | None) -> Iterator[None]:
    """Store the text that the body prints as ``study.txt`` in the folder of its study.

    Nothing is stored if the body raises, or if it writes this file itself.
    """
    if out is None:
        yield
        return
    from scenarios.files.writing import write_text
    from scenarios.report.summary import TEXT

    path = out / TEXT
    before = _written_file(path)
    stream = _CopyingStream(sys.stdout)
    with contextlib.redirect_stdout(cast(TextIO, stream)):
        yield
    if out.is_dir() and _written_file(path) == before:
        with contextlib.suppress(OSError):  # the study is complete without this file
            write_text(path, _COLOURS.sub("", stream.copy.getvalue()))


def _written_file(path: Path) -> tuple[int, int] | None:
    """Return inode and time of writing (ns) of a file; None if there is no file.

    The pair differs if the file is written again.
    """
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


@contextlib.contextmanager
def output_options(
    out: Path | None, figures: Formats, *, quiet: bool, as_json: bool, documents: Sequence[str] = ()
) -> Iterator[OutputOptions]:
    """Run the body of a command with its output options.

    Parameters
    ----------
    out : folder of the study; None writes nothing.
    figures : formats of the figures.
    quiet : print only the warnings of the documents, on stderr.
    as_json : print only the documents, several as a list.
    documents : paths of the JSON documents that the command writes, relative to its folder.

    With ``quiet`` or ``as_json`` but without ``out``, a temporary folder is used.
    """
    # A document in a subfolder belongs to a study that writes its own text.
    text_folder = out if any("/" not in name for name in documents) else None
    if not (quiet or as_json):
        with keeping_text(text_folder):
            yield OutputOptions(out, figures, progress=True)
        return
    with contextlib.ExitStack() as stack:
        folder = out
        if folder is None:
            temporary = stack.enter_context(TemporaryDirectory(prefix="flightid-"))
            folder = Path(temporary) / "study"
        try:
            with contextlib.redirect_stdout(io.StringIO()), keeping_text(text_folder):
                yield OutputOptions(folder, figures if out is not None else (), progress=not quiet)
        except KeyboardInterrupt:
            if out is not None:
                raise
            # The text of this exception names results in the temporary folder, which is deleted.
            raise KeyboardInterrupt from None
        texts = [(folder / name).read_text(encoding="utf-8") for name in documents]
    if as_json:
        _print_json(texts)
        return
    for text in texts:
        for warning in json.loads(text).get("warnings", ()):
            print(f"flightid: warning: {warning}", file=sys.stderr)


def _print_json(texts: Sequence[str]) -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        # JSON is UTF-8; a pipe of Windows has another encoding.
        sys.stdout.reconfigure(encoding="utf-8", errors="backslashreplace")
    if len(texts) == 1:
        sys.stdout.write(texts[0])
    else:
        sys.stdout.write("[\n" + ",\n".join(text.rstrip("\n") for text in texts) + "\n]\n")
    sys.stdout.flush()


@dataclass(frozen=True)
class Preparation:
    """Options on the reading and preparation of records."""

    channels: Channels = None
    columns: Columns = None
    start: From = None
    stop: To = None
    maneuver: Maneuvers = None
    maneuvers: ManeuverFile = None
    hold: Held = None
    rate: Rate = None
    lowpass: Lowpass = None

    def plan(self, records: Sequence[Path], *, trusted: bool = False) -> Plan:
        """Return the plan of preparation that the options declare.

        Parameters
        ----------
        records : the record files; a file of maneuvers may stand beside them.
        trusted : value of ``--trust-record``.

        Raises
        ------
        DeclarationError : options contradict each other, or the file lacks a maneuver.
        """
        plan = plan_of(
            self.start,
            self.stop,
            self.hold,
            self.rate,
            self.lowpass,
            trusted=trusted,
            columns=self.columns,
        )
        return with_maneuvers(plan, records, self.maneuver, self.maneuvers)


@dataclass(frozen=True)
class Output:
    """Options on the study's folder, its figures and the terminal."""

    out: Out = None
    figures: Figures = None
    no_figures: NoFigures = False
    quiet: Quiet = False
    as_json: AsJson = False

    def writing(self, *documents: str) -> AbstractContextManager[OutputOptions]:
        """Return the context of a command that writes JSON ``documents``; see `output_options`."""
        return output_options(
            self.out,
            formats_of(self.figures, self.no_figures),
            quiet=self.quiet,
            as_json=self.as_json,
            documents=documents,
        )


GROUPS: tuple[type[Any], ...] = (Preparation, Output)


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of a group in place of each parameter that is a group.

    Parameters
    ----------
    command : function with annotations for the command line. Parameters with a type in ``GROUPS``
        are groups; they are keyword-only.

    Examples
    --------
    >>> def show(*, output: Output) -> None:
    ...     print(output.quiet, output.out)
    >>> show = with_groups(show)
    >>> list(inspect.signature(show).parameters)
    ['out', 'figures', 'no_figures', 'quiet', 'as_json']
    >>> show(quiet=True)
    True None
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type[Any]] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if hints[name] not in GROUPS:
            parameters.append(parameter.replace(annotation=hints[name]))
            continue
        groups[name] = hints[name]
        field_hints = get_type_hints(hints[name], include_extras=True)
        parameters += [
            inspect.Parameter(
                item.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=item.default,
                annotation=field_hints[item.name],
            )
            for item in dataclasses.fields(hints[name])
        ]

    @functools.wraps(command)
    def with_options(*args: Any, **options: Any) -> None:
        for name, group in groups.items():
            names = [item.name for item in dataclasses.fields(group)]
            options[name] = group(**{key: options.pop(key) for key in names if key in options})
        command(*args, **options)

    vars(with_options)["__signature__"] = inspect.Signature(parameters)
    with_options.__annotations__ = {
        parameter.name: parameter.annotation for parameter in parameters
    }
    return with_options
