"""Machine-read text of the two papers: the numbers of its lines, and which rows of tables that we
hold are not printed there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import cache
from typing import Any

# A decimal number and, where there is one, its power of ten: "0.385 \times 10^{-5}" or "0.486 × 10
# <sup>-3</sup>".
NUMBER = re.compile(r"(-?\d*\.?\d+)(?:\s*(?:\\times|×)\s*10\s*(?:\^|<sup>)\s*\{?\s*(-?\d+))?")
# The reading puts marks of its own, labels' indices and cells read twice between two numbers of a
# row: so many at most.
STRAY = 6


@cache
def numbers_of(text: str) -> tuple[Decimal, ...]:
    """Every number of a text in its order, powers of ten worked in."""
    return tuple(
        Decimal(digits).scaleb(int(power) if power else 0) for digits, power in NUMBER.findall(text)
    )


def is_printed(row: Sequence[Decimal], text: str) -> bool:
    """Whether the numbers of a row stand in a text in this order, with at most ``STRAY`` others
    between two of them.
    """
    found = numbers_of(text)
    ends = {i for i, number in enumerate(found) if number == row[0]}
    for wanted in row[1:]:
        ends = {
            i
            for end in ends
            for i in range(end + 1, min(end + 2 + STRAY, len(found)))
            if found[i] == wanted
        }
    return bool(ends)


def section(text: str, begin: str, end: str) -> str:
    """The text from one mark to the next one after it; ValueError where either is absent."""
    after = text[text.index(begin) :]
    return after[: after.index(end)]


@cache
def one_line(text: str) -> str:
    return " ".join(text.split())


def lines_of(text: str, *begins: str) -> str:
    """The lines that begin with one of some texts, joined."""
    return "\n".join(line for line in text.splitlines() if line.startswith(begins))


def unread_of_simulated_data(
    held: Mapping[str, Any], truth: Mapping[str, Decimal], text: str
) -> list[str]:
    """Rows of the first paper's tables, as we hold them, that its text does not have: the true
    value, the values, their sigmas.
    """
    places = {
        "rigid": section(text, "Parameters\tTrue\tNo Process", "Fig. 10"),
        "rigid_equivalent": section(text, "Table 4 Equivalent", "For the case of"),
        "first_mode": section(text, "Table 5 Estimated", "CONCLUSION"),
    }
    beta, fall = truth["beta"], lines_of(text, "Ballistic Coefficient")
    out = []
    for kind in ("", "process_noise_"):
        cells = [
            held["ballistic"][f"{kind}{terms}"]["beta"] for terms in ("two_terms", "three_terms")
        ]
        out += (
            []
            if is_printed(
                [beta, *(cell[which] for cell in cells for which in ("value", "std"))], fall
            )
            else [f"ballistic.{kind}beta"]
        )
    for table, place in places.items():
        for name in held[table][next(iter(held[table]))]:
            cells = [column[name] for column in held[table].values()]
            row = [
                truth[name],
                *(cell["value"] for cell in cells),
                *(cell["std"] for cell in cells),
            ]
            out += [] if is_printed(row, place) else [f"{table}.{name}"]
    return out


def unread_of_vehicles(
    entries: Mapping[str, Mapping[str, Any]], texts: Mapping[str, str]
) -> list[str]:
    """Numbers of sim/data outside the tables that the sentences around them do not have."""
    sentences = {
        "ballistic_target.parameters.air_density_reference": "{} e^{{-x/22000}}",
        "ballistic_target.parameters.density_scale_height": "0.0034 e^{{-x/{}}}",
        "ballistic_target.initial.velocity": "had a velocity of {} ft/s towards",
        "x29.computer.frame_rate": "operating at {} Hz",
        "ballistic_target.initial.altitude": "was initially at {} ft above",
        "x29.telemetry.rate": "samples/sec ({} Hz)",
    }
    whole = one_line("\n".join(texts.values()))
    shown = {
        key: str(entries[key].get("printed", f"{entries[key]['value'].normalize():f}"))
        .split()[0]
        .removeprefix("-")
        for key in sentences
    }
    return [key for key, sentence in sentences.items() if sentence.format(shown[key]) not in whole]


def truth_of(entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Decimal]:
    """The true values of the first paper by short name, as sim/data shows them."""
    return {
        key.rsplit(".", 1)[1]: Decimal((e.get("printed_by_paper") or e["printed"]).split()[0])
        for key, e in entries.items()
        if "printed" in e
    }
