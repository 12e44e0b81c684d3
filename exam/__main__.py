"""How often the tracing loop and the estimators are right: ``python -m exam NAME ...``."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module

from scenarios.cli.application import ending_signals

# Name -> module and function of its command line, and what it examines; `tabled` takes the name
# first.
EXAMINATIONS: Mapping[str, tuple[str, str, str]] = {
    "random": ("exam.random_cases.examination", "random_cases", "random cases, by their seeds"),
    "foreign": (
        "exam.random_cases.examination",
        "foreign_causes",
        "random cases with a cause that no effect of the library names",
    ),
    "recorder": (
        "exam.random_cases.examination",
        "recorder_faults",
        "random cases with a fault of the recorder",
    ),
    "score": ("exam.random_cases.examination", "score", "tables of random cases from their files"),
    "surrogates": ("exam.commands", "surrogates", "campaign of surrogate flights"),
    "surrogate": ("exam.commands", "surrogate", "one surrogate flight, diagnosed"),
    "surrogate-records": ("exam.commands", "surrogate_records", "its records as files"),
    "hidden-effects": (
        "exam.commands",
        "hidden_effects",
        "campaign of a scenario trace-...",
    ),
    "every-effect": ("exam.commands", "every_effect", "each effect of the library, hidden in turn"),
    "clean": (
        "exam.commands",
        "tabled",
        "clean records of every model: false claims, and sigmas against the Cramer-Rao bound",
    ),
    "false-alarms": ("exam.commands", "tabled", "clean records in many settings"),
    "weak-effects": ("exam.commands", "tabled", "one weak effect a flight: how many are found"),
    "coverage": (
        "exam.coverage.every_scenario",
        "main",
        "coverage of every scenario: writes docs/campaign-statistics.md",
    ),
    "coverage-estimators": (
        "exam.coverage.estimators",
        "main",
        "coverage of every estimator: the table in docs/estimators.md",
    ),
    "coverage-responses": (
        "exam.coverage.frequency_responses",
        "main",
        "coverage of frequency responses, margins and fits: the table in docs/estimators.md",
    ),
    "independent": (
        "exam.independent.command",
        "main",
        "flights of independent simulators, diagnosed from files alone and graded",
    ),
    "ablate": (
        "exam.ablation",
        "ablate",
        "one rule of the tracing loop left out at a time",
    ),
    "papers-page": (
        "exam.reproduction.command",
        "main",
        "two papers, number by number: writes docs/papers.md",
    ),
}
WHAT = "How often the tracing loop and the estimators are right."
# Linear algebra of small matrices: more threads only wait for one another.
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def help_text() -> str:
    """Every examination in a line."""
    width = max(map(len, EXAMINATIONS))
    lines = [f"  {name:{width}}  {what}" for name, (_, _, what) in EXAMINATIONS.items()]
    head = ["usage: python -m exam NAME ...", "", WHAT, ""]
    return "\n".join([*head, *lines, "", "python -m exam NAME --help says what one takes."])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one examination; 2 with one line where there is none of that name."""
    for name in THREADS:
        os.environ.setdefault(name, "1")  # read when NumPy is loaded
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("--help", "-h"):
        print(help_text())
        return 0
    if name not in EXAMINATIONS:
        from scenarios.files.declarations import closest

        remedy = closest(name, EXAMINATIONS)
        print(f"python -m exam: there is no examination {name!r}; {remedy}", file=sys.stderr)
        return 2
    module, function, _ = EXAMINATIONS[name]
    run = getattr(import_module(module), function)
    with ending_signals() as came:
        try:
            code = int(run(name, rest) if function == "tabled" else run(rest))
        except KeyboardInterrupt:
            print("python -m exam: ended before it was done", file=sys.stderr)
            code = 128 + signal.SIGINT
    return 128 + came[0] if came else code


if __name__ == "__main__":
    sys.exit(main())
