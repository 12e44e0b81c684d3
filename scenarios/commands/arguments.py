"""Arguments as they are typed, made into those that the command-line library understands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.trials.planted.own_flight import OwnFlight


def each_validated(given: list[str]) -> list[str]:
    """``--validate A B`` as ``--validate A --validate B``: the option takes every file up to the next option, as it is documented.

    Where that would leave no record to fit, it takes one file only.
    """
    if given[:1] != ["diagnose"]:
        return given
    out, taking, fitted = [], 0, 0
    for place, text in enumerate(given[1:], start=1):
        option = text.startswith("-") and text != "-"
        if not option and taking > 1:
            out += ["--validate", text]
            continue
        out.append(text)
        if option:
            taking = 1 if text == "--validate" else 0
        elif taking == 1:
            taking = 2
        elif not given[place - 1].startswith("--") or given[place - 1] in ("--figures", "--no-figures", "--trust-record"):
            fitted += 1
    return ["diagnose", *out] if fitted else given


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
