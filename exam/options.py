"""Command lines of the examinations: common options, and failures in one line."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from scenarios.files.sources import versions
from scenarios.report.document import Reproduction
from scenarios.report.figure_formats import Formats, formats_of
from scenarios.tasks.study import Execution
from sim.errors import FlightidError

STOPPED = 130  # exit code after Ctrl-C: 128 plus the number of the signal


class Parser(argparse.ArgumentParser):
    """The parser of one examination; errors are printed in one line."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(prog=f"python -m exam {name}", description=description)

    def error(self, message: str) -> NoReturn:
        """Print the message in one line and end with exit code 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")

    def add_manner(self, *, out_required: bool = False) -> None:
        """Add options for the execution of repeated work; ``manner_of`` reads them."""
        self.add_argument("--out", type=Path, required=out_required, metavar="DIR", help="folder")
        self.add_argument("--jobs", type=int, metavar="N", help="processes; default: one a core")
        self.add_argument(
            "--cluster", metavar="ADDRESS", help="scheduler of a Dask cluster, tcp://HOST:PORT"
        )
        self.add_argument("--resume", action="store_true", help="go on with what the folder holds")
        self.add_argument("--time-limit", type=float, metavar="S", help="s that a flight may take")

    def add_campaign(self, *, runs_required: bool = True) -> None:
        """Add options of a campaign."""
        self.add_argument(
            "--runs", type=int, required=runs_required, metavar="N", help="two or more"
        )
        self.add_argument("--seed", type=seed, help="from which those of all flights spring")
        self.add_figures()
        self.add_manner()

    def add_figures(self) -> None:
        """Add the formats of figures; ``figures_of`` reads them."""
        self.add_argument(
            "--figures", metavar="FORMAT,...", help="png (default), svg, pdf, or none"
        )
        self.add_argument("--no-figures", action="store_true", help="draw none")

    def add_changes(self) -> None:
        """Add changes of a scenario's file."""
        self.add_argument(
            "--set",
            action="append",
            default=[],
            dest="changes",
            metavar="KEY=VALUE",
            help="change an entry of the file, for example flight.rate=50",
        )


def seed(text: str) -> int:
    """Return a seed from its text; raise ValueError below zero."""
    number = int(text)
    if number < 0:
        raise ValueError
    return number


def manner_of(asked: argparse.Namespace) -> Execution:
    """Return the settings of repeated work."""
    return Execution(asked.jobs, asked.out, asked.resume, asked.cluster, asked.time_limit)


def figures_of(asked: argparse.Namespace) -> Formats:
    """Return the formats of figures."""
    return formats_of([asked.figures] if asked.figures else None, asked.no_figures)


def ended_in_one_line(name: str, work: Callable[[], int]) -> int:
    """Run some work and return the exit code: 2 with one line for a fault, 130 with one line for
    Ctrl-C.
    """
    try:
        return work()
    except (FlightidError, OSError) as fault:
        print(f"python -m exam {name}: {' '.join(str(fault).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stopped:
        text = str(stopped) or "nothing was written"
        print(f"python -m exam {name}: stopped; {text}", file=sys.stderr)
        return STOPPED


Main = Callable[[Sequence[str] | None], int]


def exam_reproduction(usual: Sequence[str], seed_words: str) -> Reproduction:
    """Return how a page is made again: the words after ``python -m exam``, else the words
    ``usual``.
    """
    program = Path((sys.argv or [""])[0])
    typed = program.name == "__main__.py" and program.parent == Path(__file__).parent
    words = sys.argv[1:] if typed else usual
    return Reproduction((shlex.join(("python", "-m", "exam", *words)),), versions(), seed_words, ())
