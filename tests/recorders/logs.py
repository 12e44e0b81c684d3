"""Writers of PX4 and ArduPilot logs, by the published descriptions of the formats; only what the
tests need of them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Topics = Mapping[str, Mapping[str, np.ndarray]]
UNIT_LETTERS = {
    "s": "s",
    "d": "deg",
    "k": "deg/s",
    "r": "rad",
    "E": "rad/s",
    "#": "instance",
    "o": "m/s/s",
    "m": "m",
    "n": "m/s",
}
FACTORS = {"B": 1e-2, "F": 1e-6}


def write_ulog(path: Path, topics: Topics) -> Path:
    """A ULog with one message a topic; its column ``timestamp`` is in microseconds, the others are
    doubles, arrays as ``q[0]``, ``q[1]``.
    """
    out = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def message(kind: bytes, body: bytes) -> None:
        out.extend(struct.pack("<HB", len(body), kind[0]) + body)

    message(b"B", bytes(8) + bytes(8) + bytes(24))
    for name, columns in topics.items():
        fields = ["uint64_t timestamp"]
        for field, count in _fields(columns):
            fields.append(f"double[{count}] {field}" if count else f"double {field}")
        message(b"F", f"{name}:{';'.join(fields)};".encode())
    for number, name in enumerate(topics):
        message(b"A", struct.pack("<BH", 0, number) + name.encode())
    rows = []
    for number, columns in enumerate(topics.values()):
        order = [
            name
            for field, count in _fields(columns)
            for name in ([f"{field}[{n}]" for n in range(count)] if count else [field])
        ]
        for row, stamp in enumerate(columns["timestamp"]):
            values = [float(columns[name][row]) for name in order]
            rows.append(
                (int(stamp), struct.pack(f"<HQ{len(values)}d", number, int(stamp), *values))
            )
    for _, body in sorted(rows, key=lambda each: each[0]):
        message(b"D", body)
    path.write_bytes(out)
    return path


def _fields(columns: Mapping[str, np.ndarray]) -> list[tuple[str, int]]:
    """Field -> elements of its array, zero of a plain one; the clock is left out."""
    found: dict[str, int] = {}
    for name in columns:
        field, _, rest = name.partition("[")
        if field != "timestamp":
            found[field] = found.get(field, 0) + bool(rest)
    return list(found.items())


def write_dataflash(
    path: Path,
    messages: Topics,
    units: Mapping[str, str] | None = None,
    factors: Mapping[str, str] | None = None,
) -> Path:
    """A DataFlash log: ``TimeUS`` as 64 bit integer, all other columns as doubles.

    ``units``: letter for each column of a message. ``factors``: likewise of the multiplier of its
    unit, ``-`` for none.
    """
    out = bytearray()

    def head(kind: int) -> bytes:
        return b"\xa3\x95" + bytes([kind])

    def declare(kind: int, length: int, name: str, form: str, columns: Sequence[str]) -> None:
        fields = struct.pack(
            "<BB4s16s64s", kind, length, name.encode(), form.encode(), ",".join(columns).encode()
        )
        out.extend(head(128) + fields)

    declare(128, 89, "FMT", "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])
    kinds = {}
    for number, (name, columns) in enumerate(messages.items()):
        kinds[name] = number + 1
        form = "".join(
            "Q" if column == "TimeUS" else "B" if column == "I" else "d" for column in columns
        )
        declare(
            number + 1,
            3 + sum({"Q": 8, "d": 8, "B": 1}[letter] for letter in form),
            name,
            form,
            list(columns),
        )
    if units:
        declare(100, 3 + 8 + 1 + 64, "UNIT", "QbZ", ["TimeUS", "Id", "Label"])
        declare(
            101, 3 + 8 + 1 + 16 + 16, "FMTU", "QBNN", ["TimeUS", "FmtType", "UnitIds", "MultIds"]
        )
        for letter, label in UNIT_LETTERS.items():
            out.extend(head(100) + struct.pack("<Qb64s", 0, ord(letter), label.encode()))
        if factors:
            declare(102, 3 + 8 + 1 + 8, "MULT", "Qbd", ["TimeUS", "Id", "Mult"])
            for letter, factor in FACTORS.items():
                out.extend(head(102) + struct.pack("<Qbd", 0, ord(letter), factor))
        for name, letters in units.items():
            out.extend(
                head(101)
                + struct.pack(
                    "<QB16s16s",
                    0,
                    kinds[name],
                    letters.encode(),
                    _multipliers(name, letters, factors).encode(),
                )
            )
    rows = []
    for name, columns in messages.items():
        form = "<" + "".join(
            "Q" if column == "TimeUS" else "B" if column == "I" else "d" for column in columns
        )
        for row, stamp in enumerate(columns["TimeUS"]):
            values = [
                int(columns[column][row])
                if column in ("TimeUS", "I")
                else float(columns[column][row])
                for column in columns
            ]
            rows.append((int(stamp), head(kinds[name]) + struct.pack(form, *values)))
    for _, body in sorted(rows, key=lambda each: each[0]):
        out.extend(body)
    path.write_bytes(out)
    return path


def _multipliers(name: str, letters: str, factors: Mapping[str, str] | None) -> str:
    return (factors or {}).get(name, "F" + "-" * (len(letters) - 1))


def write_dataflash_text(
    path: Path,
    messages: Topics,
    units: Mapping[str, str] | None = None,
    factors: Mapping[str, str] | None = None,
    *,
    before: str = "",
    mark: str = ", ",
) -> Path:
    """The log of ``write_dataflash`` as ground stations export it: one message a line; ``before``:
    lines above, ``mark``: between cells."""
    lines = [["FMT", "128", "89", "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"]]
    for number, (name, columns) in enumerate(messages.items()):
        form = "".join(
            "Q" if column == "TimeUS" else "B" if column == "I" else "d" for column in columns
        )
        size = 3 + sum({"Q": 8, "d": 8, "B": 1}[letter] for letter in form)
        lines.append(["FMT", str(number + 1), str(size), name, form, ",".join(columns)])
    if units:
        lines += [
            ["FMT", "100", "76", "UNIT", "QbZ", "TimeUS,Id,Label"],
            ["FMT", "101", "44", "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"],
        ]
        lines += [["UNIT", "0", str(ord(letter)), label] for letter, label in UNIT_LETTERS.items()]
        if factors:
            lines.append(["FMT", "102", "20", "MULT", "Qbd", "TimeUS,Id,Mult"])
            lines += [
                ["MULT", "0", str(ord(letter)), repr(factor)] for letter, factor in FACTORS.items()
            ]
        kinds = {name: number + 1 for number, name in enumerate(messages)}
        lines += [
            ["FMTU", "0", str(kinds[name]), letters, _multipliers(name, letters, factors)]
            for name, letters in units.items()
        ]
    lines.append(["PARM", "0", "ARSPD_USE", "1"])
    rows = []
    for name, columns in messages.items():
        for row, stamp in enumerate(columns["TimeUS"]):
            values = [
                str(int(columns[each][row]))
                if each in ("TimeUS", "I")
                else repr(float(columns[each][row]))
                for each in columns
            ]
            rows.append((int(stamp), [name, *values]))
    lines += [cells for _, cells in sorted(rows, key=lambda each: each[0])]
    path.write_text(before + "\n".join(mark.join(cells) for cells in lines) + "\n", newline="\n")
    return path
