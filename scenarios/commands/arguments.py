"""Arguments as they are typed, made into those that the command-line library understands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.preparation.plan import Plan
    from scenarios.trials.planted.own_flight import OwnFlight

SEVERAL = {"diagnose": ("--validate",), "identify": ("--validate", "--profile")}  # options that take every word up to the next option
NONE_MEANS = {"--profile": "all"}  # what such an option without a word stands for
FLAGS = ("--no-figures", "--trust-record", "--quiet", "--json")
BAND = ("--band",)  # options of two words
FILES = (".csv", ".parquet", ".mat", ".tsv", ".txt")  # ends of what is a record and no parameter


def each_validated(given: list[str]) -> list[str]:
    """``--validate A B`` as ``--validate A --validate B``, and so ``--profile``: they take every word up to the next option, as documented.

    Where that would leave no record to fit, ``--validate`` takes one file only. ``--profile`` takes no record, and alone means all parameters.
    """
    several = SEVERAL.get(given[0], ()) if given else ()
    if not several:
        return given
    out, fitted = _expanded(given, several)
    return out if fitted else _expanded(given, [option for option in several if option != "--validate"])[0]


def _expanded(given: list[str], several: Sequence[str]) -> tuple[list[str], int]:
    """The words with the options ``several`` before each of theirs, and how many of them are records to be fitted."""
    out, option, taken, fitted = [given[0]], "", 0, 0
    for text in given[1:]:
        if text.startswith("-") and text != "-":
            out += _unsaid(option, taken)
            option, taken = text, 0
            out.append(text)
            continue
        if option in several and not (option == "--profile" and text.lower().endswith(FILES)):
            out += [text] if taken == 0 else [option, text]
            taken += 1
            continue
        wanted = 0 if option in ("", *FLAGS, *several) or "=" in option else 2 if option in BAND else 1
        if taken >= wanted:
            out += _unsaid(option, taken)
            fitted += 1
            option, taken = ("", 0) if option in several else (option, taken)
        else:
            taken += 1
        out.append(text)
    out += _unsaid(option, taken)
    return out, fitted


def _unsaid(option: str, taken: int) -> list[str]:
    """What an option means that was given no word."""
    return [NONE_MEANS[option]] if option in NONE_MEANS and taken == 0 else []


def one_segment(plan: Plan) -> Plan:
    """A plan for one part of a record; DeclarationError where it has several."""
    if len(plan.segments) > 1:
        raise DeclarationError("a prediction is of one part of a record", where="--from, --to, --maneuver", remedy="give each of them once")
    return plan


def scenario_or_own(
    name: str | None,
    model: str | None,
    vehicle: Path | None,
    inputs: Sequence[str] | None,
    noise: Sequence[str] | None,
    hidden: Sequence[str] | None,
    duration: float | None,
    rate: float | None,
) -> str | OwnFlight:
    """What is to be flown: a scenario by its name, or a user's own model with what else was said of its flight.

    Raises
    ------
    DeclarationError : both or neither, or an option that only ``--model`` takes.
    """
    if model is None:
        given = {"--vehicle": vehicle, "--input": inputs, "--noise": noise, "--hide": hidden, "--duration": duration, "--rate": rate}
        if name is None:
            raise DeclarationError("nothing is named", where="flightid", remedy="name a scenario (flightid list), or --model FILE.py")
        for option, value in given.items():
            if value is not None:
                remedy = "change an entry of a scenario with --set, for example flight.rate=50"
                raise DeclarationError("this goes with --model FILE.py", where=option, remedy=remedy)
        return name
    if name is not None:
        raise DeclarationError(f"a scenario is named as well, {name!r}", where="--model", remedy="leave one of the two out")
    from scenarios.trials.planted.own_flight import OwnFlight

    return OwnFlight(model, vehicle, tuple(inputs or ()), tuple(noise or ()), tuple(hidden or ()), duration, rate)
