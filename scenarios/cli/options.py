"""Options that several commands share, shell completion, and output options.

Options that go together in several commands: how records are prepared, and what of a command
reaches the terminal and the disk.

A command takes such a group as one keyword parameter, and `with_groups` turns it into its options.
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
from typing import Annotated, Any, TextIO, get_type_hints

import typer

from scenarios.preparation.plan import Plan, plan_of, with_maneuvers
from scenarios.report.figure_formats import Formats, formats_of

# ---- What a shell completes

# Copies of lists, so that help and completion load no numerics; a test compares them.
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
TO_HELP = f"{', '.join(TARGETS)}; the last two of model aircraft alone."
METHOD_NAMES = ("output-error", "filter-error", "frequency-domain", "equation-error", "ekf", "ukf")


def scenarios(incomplete: str) -> list[str]:
    """Scenarios of the catalogue."""
    from scenarios.studies.catalogue import scenario_names

    return _beginning(scenario_names(), incomplete)


def models(incomplete: str) -> list[str]:
    """Built-in models."""
    return _beginning(MODEL_NAMES, incomplete)


def methods(incomplete: str) -> list[str]:
    """Methods of identification."""
    return _beginning(METHOD_NAMES, incomplete)


def effects(incomplete: str) -> list[str]:
    """Effects of the library."""
    from sim.effects.library import effect_names

    return _beginning(effect_names(), incomplete)


def vehicles(incomplete: str) -> list[str]:
    """Vehicles of the library."""
    from sim.vehicles.library import vehicle_names

    return _beginning(vehicle_names(), incomplete)


def of(*words: str) -> Callable[[str], list[str]]:
    """A completion with a few fixed words."""

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
    """An option with a value: name, word for the value, help; ``bounds``: min, max."""
    return typer.Option(name, metavar=metavar, help=explanation, autocompletion=complete, **bounds)


def flag(name: str, explanation: str) -> Any:
    """An option without a value: its name and its line of help."""
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
        "--from", "T", "Use the record from this time on, s; with --to again for each maneuver."
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
    Path | None, valued("--maneuvers", "FILE", "That file; else maneuvers.toml beside the record.")
]
Held = Annotated[
    str | None,
    valued(
        "--hold",
        "HOLD",
        "Inputs between samples: previous or linear; else as the data say.",
        complete=of("previous", "linear"),
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
        metavar="NAME", autocompletion=scenarios, help="A scenario; none beside --model."
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
        "--noise", "OUTPUT=SIZE", "With --model: standard deviation; else 1 % of its largest move."
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
        complete=of("png", "svg", "pdf", "none"),
    ),
]
NoFigures = Annotated[bool, flag("--no-figures", "Draw none, as --figures none.")]
Class = Annotated[
    str | None,
    valued(
        "--class",
        "I..IV",
        "Class of the aircraft, for levels of flying qualities; II-C: carrier.",
        complete=of("I", "II", "II-C", "III", "IV"),
    ),
]
Category = Annotated[
    str | None,
    valued(
        "--category",
        "A|B|C",
        "Category of the flight phase: A rapid, B gradual, C terminal.",
        complete=of("A", "B", "C"),
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
    valued(
        "--jobs", "N", "Processes, each with one thread; else one a core. No number depends on it."
    ),
]
Resume = Annotated[
    bool,
    flag(
        "--resume", "Go on with what the folder of --out holds; --runs may be larger than before."
    ),
]
Cluster = Annotated[
    str | None,
    valued("--cluster", "ADDRESS", "Work on a Dask cluster, by its scheduler's tcp://HOST:PORT."),
]
TimeLimit = Annotated[
    float | None,
    valued("--time-limit", "S", "Seconds that a run may take; one that takes longer is left out."),
]


# ---- --quiet and --json: what of a command reaches the terminal


@dataclass(frozen=True)
class OutputOptions:
    """Where a command writes its study (None: nowhere), in which formats its figures, and whether
    it may show how far it is.
    """

    out: Path | None
    figures: Formats
    progress: bool


_COLOURS = re.compile(r"\x1b\[[0-9;]*m")  # escape sequences of a terminal


class _Copied(io.TextIOBase):
    """A stream that also stores what is written to it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self.kept = stream, io.StringIO()

    def write(self, text: str) -> int:
        self.kept.write(text)
        return self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def writable(self) -> bool:
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return self._stream.errors


@contextlib.contextmanager
def keeping_text(out: Path | None) -> Iterator[None]:
    """Store the printed text of a successful command as ``study.txt`` in its folder.

    Only if the command does not write this file itself.
    """
    if out is None:
        yield
        return
    from scenarios.files.writing import write_text
    from scenarios.report.summary import TEXT

    path = out / TEXT
    before = _identity(path)
    copied = _Copied(sys.stdout)
    with contextlib.redirect_stdout(copied):
        yield
    if out.is_dir() and _identity(path) == before:
        with contextlib.suppress(OSError):  # the study is whole without it
            write_text(path, _COLOURS.sub("", copied.kept.getvalue()))


def _identity(path: Path) -> tuple[int, int] | None:
    """Return inode and time of writing of a file; None if there is none."""
    try:
        told = path.stat()
    except OSError:
        return None
    return told.st_ino, told.st_mtime_ns


@contextlib.contextmanager
def output_options(
    out: Path | None, figures: Formats, *, quiet: bool, as_json: bool, documents: Sequence[str] = ()
) -> Iterator[OutputOptions]:
    """Context manager for a command that prints and writes ``documents`` (JSON files).

    ``as_json``: print only the documents, several as a list. ``quiet``: print only the documents'
    warnings, on stderr. Without a folder, a temporary one is used.
    """
    # Studies in folders of their own each have their text already.
    kept = out if any("/" not in name for name in documents) else None
    if not (quiet or as_json):
        with keeping_text(kept):
            yield OutputOptions(out, figures, progress=True)
        return
    with contextlib.ExitStack() as stack:
        folder = (
            out
            if out is not None
            else Path(stack.enter_context(TemporaryDirectory(prefix="flightid-"))) / "study"
        )
        try:
            with contextlib.redirect_stdout(io.StringIO()), keeping_text(kept):
                yield OutputOptions(folder, figures if out is not None else (), progress=not quiet)
        except KeyboardInterrupt:
            if out is not None:
                raise
            # its folder is deleted
            raise KeyboardInterrupt from None
        texts = [(folder / name).read_text(encoding="utf-8") for name in documents]
    if as_json:
        if isinstance(sys.stdout, io.TextIOWrapper):
            # JSON is UTF-8 wherever it goes; a pipe of Windows has another code page.
            sys.stdout.reconfigure(encoding="utf-8", errors="backslashreplace")
        sys.stdout.write(
            texts[0]
            if len(texts) == 1
            else "[\n" + ",\n".join(text.rstrip("\n") for text in texts) + "\n]\n"
        )
        sys.stdout.flush()
        return
    for text in texts:
        for warning in json.loads(text).get("warnings", ()):
            print(f"flightid: warning: {warning}", file=sys.stderr)


@dataclass(frozen=True)
class Preparation:
    """Options by which records are read and prepared; the names are those of the command."""

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
        """The plan of these options.

        Parameters
        ----------
        records : beside which a file of maneuvers is looked for.
        trusted : of ``--trust-record``.

        Raises
        ------
        DeclarationError : options that contradict each other, or a maneuver that the file lacks.
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

    def of(self, *documents: str) -> AbstractContextManager[OutputOptions]:
        """Context of a command that writes JSON ``documents``: see `output_options`."""
        return output_options(
            self.out,
            formats_of(self.figures, self.no_figures),
            quiet=self.quiet,
            as_json=self.as_json,
            documents=documents,
        )


GROUPS: tuple[type[Any], ...] = (Preparation, Output)


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters of a type in ``GROUPS`` are the options of that group, in place.

    Parameters
    ----------
    command : function with annotations that the command line reads; its groups are keyword-only.

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
        inside = get_type_hints(hints[name], include_extras=True)
        parameters += [
            inspect.Parameter(
                item.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=item.default,
                annotation=inside[item.name],
            )
            for item in dataclasses.fields(hints[name])
        ]

    @functools.wraps(command)
    def told(*args: Any, **typed: Any) -> None:
        for name, kind in groups.items():
            names = [item.name for item in dataclasses.fields(kind)]
            typed[name] = kind(**{each: typed.pop(each) for each in names if each in typed})
        command(*args, **typed)

    vars(told)["__signature__"] = inspect.Signature(parameters)
    told.__annotations__ = {each.name: each.annotation for each in parameters}
    return told
