"""Options that go together in several commands: how records are prepared, and what of a command
reaches the terminal and the disk.

A command takes such a group as one keyword parameter, and `with_groups` turns it into its options.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from scenarios.cli.options import (
    AsJson,
    Channels,
    Columns,
    Figures,
    From,
    Held,
    Lowpass,
    ManeuverFile,
    Maneuvers,
    NoFigures,
    Out,
    OutputOptions,
    Quiet,
    Rate,
    To,
    output_options,
)
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import Plan, plan_of
from scenarios.report.figure_formats import formats_of


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
        records : beside which a file of maneuvers is looked for. trusted : of ``--trust-record``.

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
