"""Ways of spoiling texts, tables, TOML files, JSON trees and Python models, each a function of a
seeded generator.
"""

from __future__ import annotations

import copy
import gzip
import json
import random
from collections.abc import Callable
from typing import Any

DEEP = 10_000
DIGITS = "9" * 5000
CONTROL = "\x1b[31mred\x1b[0m\x07"
HTML = "<script>alert(1)</script><img src=x onerror=alert(2)>"
ARABIC, WIDE = (
    str.maketrans("0123456789", "٠١٢٣٤٥٦٧٨٩"),
    str.maketrans("0123456789", "０１２３４５６７８９"),
)
EXTREMES = (
    "1e308",
    "-1e308",
    "1e-300",
    "-28e300",
    "1e400",
    "0",
    "-1",
    "inf",
    "nan",
    "5e-324",
    "1e150",
    "1e-150",
    "9" * 400,
)
UNITS = (
    "ft**9**9**9",
    "lb**9**9**9",
    "m**999999999",
    "kg**-99999999999",
    "ft^(9^9^9)",
    "((((((((m))))))))",
    "m/0",
    "1/0",
    "lb*" * 12 + "lb",
    "deg**1e9",
    "2**99999 ft",
    "ft**9.9e99",
    "furlong/fortnight",
    "",
    " ",
    "\x1b[31m",
    "٣ ft",
    "m" * 5000,
    "%",
    "degC",
    "dB",
    "__import__",
)


def spoiled_table(text: str, draw: random.Random) -> bytes:
    """A record of comma-separated text with one thing wrong."""
    return draw.choice(_TABLES)(text, draw)


def _rows(text: str) -> list[list[str]]:
    return [line.split(",") for line in text.splitlines()]


def _joined(rows: list[list[str]]) -> bytes:
    return ("\n".join(",".join(row) for row in rows) + "\n").encode()


def _cells(
    value: Callable[[str, random.Random], str], column: int | None = None
) -> Callable[[str, random.Random], bytes]:
    def spoil(text: str, draw: random.Random) -> bytes:
        rows = _rows(text)
        at = draw.randrange(len(rows[0])) if column is None else column
        for k in draw.sample(range(1, len(rows)), draw.choice((1, 1, 3, len(rows) - 1))):
            rows[k][at] = value(rows[k][at], draw)
        return _joined(rows)

    return spoil


def _header(value: Callable[[str, random.Random], str]) -> Callable[[str, random.Random], bytes]:
    def spoil(text: str, draw: random.Random) -> bytes:
        rows = _rows(text)
        at = draw.randrange(len(rows[0]))
        rows[0][at] = value(rows[0][at], draw)
        return _joined(rows)

    return spoil


def _missing_rows(text: str, draw: random.Random) -> bytes:
    rows = _rows(text)
    gone = set(draw.sample(range(5, len(rows) - 5), draw.choice((1, 6, 12))))
    return _joined([row for k, row in enumerate(rows) if k not in gone])


def _uneven(text: str, draw: random.Random) -> bytes:
    rows = _rows(text)
    for row in rows[1:]:
        row[0] = repr(float(row[0]) + draw.uniform(0.0, 0.015))
    return _joined(rows)


def _few(text: str, draw: random.Random) -> bytes:
    return _joined(_rows(text)[: draw.choice((0, 1, 2, 3, 4, 6))])


def _stretched(text: str, draw: random.Random) -> bytes:
    rows, factor = _rows(text), float(draw.choice(("1e306", "1e-9", "1e9", "1e-300", "1e15")))
    for row in rows[1:]:
        row[0] = repr(float(row[0]) * factor)
    return _joined(rows)


def _scaled(text: str, draw: random.Random) -> bytes:
    rows, factor = _rows(text), float(draw.choice(("1e300", "1e-300", "1e150", "-28e300", "0")))
    at = draw.randrange(1, len(rows[0]))
    for row in rows[1:]:
        row[at] = repr(float(row[at]) * factor)
    return _joined(rows)


def _bytes(text: str, draw: random.Random) -> bytes:
    raw = bytearray(text.encode())
    for _ in range(draw.choice((1, 5, 50))):
        raw[draw.randrange(len(raw))] = draw.randrange(256)
    return bytes(raw)


_TABLES: tuple[Callable[[str, random.Random], bytes], ...] = (
    _cells(lambda cell, draw: draw.choice(EXTREMES)),
    _cells(lambda cell, draw: draw.choice(EXTREMES), 0),
    _cells(lambda cell, draw: cell.translate(draw.choice((ARABIC, WIDE)))),
    _cells(
        lambda cell, draw: draw.choice(
            (
                CONTROL,
                HTML,
                "1_000",
                "0x10",
                "1,5",
                "--",
                '"',
                "\0",
                DIGITS,
                "TRUE",
                "1e",
                "+",
                "１.0",
            )
        )
    ),
    _header(lambda cell, draw: cell + CONTROL),
    _header(lambda cell, draw: f"{cell} [{draw.choice(UNITS)}]"),
    _header(lambda cell, draw: cell + "_" + "x" * 140_000),
    _header(
        lambda cell, draw: draw.choice(
            ("", '"', HTML, cell + " [deg", "time", "alpha", "\ufeff" + cell, "٣")
        )
    ),
    _missing_rows,
    _uneven,
    _few,
    _stretched,
    _scaled,
    _bytes,
    lambda text, draw: _joined(
        [row if k else row * draw.choice((2, 400)) for k, row in enumerate(_rows(text))]
    ),
    lambda text, draw: _joined(_rows(text)[:1] + _rows(text)[:0:-1]),
    lambda text, draw: text.encode("utf-16"),
    lambda text, draw: text.encode("utf-8-sig"),
    lambda text, draw: gzip.compress(text.encode(), mtime=0)[: draw.choice((10, 60, -9))],
    lambda text, draw: draw.randbytes(draw.choice((1, 100, 5000))),
    lambda text, draw: text.replace(",", draw.choice((";", "\t", " ", "|", "\0"))).encode(),
    lambda text, draw: text.encode() + text.encode(),
)


def spoiled_toml(text: str, draw: random.Random) -> bytes:
    """A TOML file with one thing wrong."""
    lines = text.splitlines()
    at = draw.choice([k for k, line in enumerate(lines) if "=" in line])
    key = lines[at].split("=")[0].strip()
    nested = draw.choice(
        (
            "[" * DEEP + "]" * DEEP,
            "{a=" * DEEP + "1" + "}" * DEEP,
            "[" * DEEP,
            "[" * 400 + "]" * 400,
        )
    )
    values = (
        nested,
        DIGITS,
        "-" + DIGITS,
        f"0.{DIGITS}",
        f'"{DIGITS} m"',
        "true",
        "[]",
        "{}",
        "[1, 2]",
        '""',
        "1979-05-27",
        "0x10",
        "1_000.0",
        "'''",
        f'"{HTML}"',
        '"\\u001b[31mred"',
        '"٣ m"',
        "٣",
        "1e",
        f'"{"x" * 20_000}"',
        *EXTREMES,
        *(f'"1 {unit}"' for unit in UNITS if "\x1b" not in unit),
    )
    kinds: tuple[Callable[[], bytes], ...] = (
        lambda: _lines(lines, at, f"{key} = {draw.choice(values)}"),
        lambda: _lines(lines, at, f"{key} = {draw.choice(values)}"),
        lambda: _lines(lines, at, f"{key} = {draw.choice(values)}"),
        lambda: _lines(lines, at, f"{key} = {nested}"),
        lambda: _lines(lines, at, ""),
        lambda: _lines(lines, at, f'"{key}\\u001b[2J" = 1'),
        lambda: _lines(lines, at, f"{'.'.join('a' * 3000)} = 1"),
        lambda: _lines(lines, at, lines[at] + "\n" + lines[at]),
        lambda: _lines(lines, at, "[" + ".".join("b" * 3000) + "]"),
        lambda: text.encode()[: draw.randrange(len(text))],
        lambda: text.encode("utf-16"),
        lambda: draw.randbytes(200),
        lambda: b"",
        lambda: "\n".join(f"k{k} = {k}" for k in range(20_000)).encode(),
    )
    return draw.choice(kinds)()


def _lines(lines: list[str], at: int, line: str) -> bytes:
    return "\n".join([*lines[:at], line, *lines[at + 1 :]]).encode()


class Raw(str):
    """A text that is written into JSON as it stands."""


def spoiled_json(text: str, draw: random.Random) -> bytes:
    """A JSON file with one to three values of its tree replaced, or its text spoiled."""
    if draw.random() < 0.15:
        return draw.choice(
            (
                b"",
                b"[]",
                b"null",
                b"{",
                text.encode()[: draw.randrange(len(text))],
                b"[" * DEEP,
                b'{"a":' * DEEP,
                draw.randbytes(300),
                text.encode("utf-16"),
            )
        )
    tree: Any = json.loads(text)
    for _ in range(draw.choice((1, 1, 2, 3))):
        tree = _spoiled_tree(tree, draw)
    return _dumped(tree).encode("utf-8", "surrogatepass")


def _spoiled_tree(tree: Any, draw: random.Random) -> Any:
    tree = copy.deepcopy(tree)
    places = [(tree, key) for key in tree] if isinstance(tree, dict) else []
    if draw.random() < 0.75:  # else a key at the top
        places = [place for place in _places(tree)]
    if not places:
        return tree
    holder, key = draw.choice(places)
    action = draw.randrange(8)
    if action == 0:
        del holder[key]
    elif action == 1 and isinstance(holder[key], dict | list):
        holder[key] = (
            list(holder[key].values())
            if isinstance(holder[key], dict)
            else {str(k): v for k, v in enumerate(holder[key])}
        )
    elif action == 2:
        holder[key] = str(holder[key])
    else:
        holder[key] = draw.choice(_VALUES)
    return tree


_VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1.5,
    10**30,
    1e308,
    "",
    "1.5",
    HTML,
    CONTROL,
    "٣",
    [],
    {},
    [[]],
    [1, "a", None],
    {"a": 1},
    "x" * 100_000,
    list(range(20_000)),
    Raw("NaN"),
    Raw("Infinity"),
    Raw("-1e999"),
    Raw(DIGITS),
    Raw("1e-400"),
    Raw("[" * DEEP + "]" * DEEP),
    Raw('{"a":' * DEEP + "1" + "}" * DEEP),
    "\ud800",
    "\0",
    "../../etc/passwd",
    "/dev/zero",
)


def _places(tree: Any) -> list[tuple[Any, Any]]:
    out: list[tuple[Any, Any]] = []
    left = [tree]
    while left:
        holder = left.pop()
        for key in (
            holder
            if isinstance(holder, dict)
            else range(len(holder))
            if isinstance(holder, list)
            else ()
        ):
            out.append((holder, key))
            left.append(holder[key])
    return out


def _dumped(tree: Any) -> str:
    if isinstance(tree, Raw):
        return str(tree)
    if isinstance(tree, dict):
        return (
            "{"
            + ",".join(f"{json.dumps(key)}:{_dumped(value)}" for key, value in tree.items())
            + "}"
        )
    if isinstance(tree, list):
        return "[" + ",".join(map(_dumped, tree)) + "]"
    return json.dumps(tree)


_LATE = """
calls = [0]

def rates(s, p):
    calls[0] += 1
    if calls[0] > {after}:
        {late}
    return {{"p": p.L_p * s.p + p.L_da * s.aileron}}
"""
_LATER = (
    "import sys; sys.exit(0)",
    "raise SystemExit",
    "raise SystemExit('bye')",
    "raise KeyboardInterrupt",
    "raise GeneratorExit",
    "raise BaseException('base')",
    "raise MemoryError",
    "raise RecursionError",
    "return rates(s, p)",
    "return {'p': [1.0, 2.0, 3.0]}",
    "return {'p': __import__('numpy').ones((3, 5, 7))}",
    "return {'p': 'text'}",
    "return {'p': None}",
    "return {}",
    "return None",
    "return {'p': float('nan')}",
    "return {'p': 1e308 * s.p * 1e308}",
    "return {'p': s.p / 0.0}",
    "return {'p': __import__('numpy').asarray(s.p, dtype=object)}",
    "__import__('numpy').divide(1.0, 0.0)",
    "raise ValueError('\\x1b[31mred\\n\\nlines')",
    "raise OSError(28, 'No space left on device')",
    "__import__('os').write(2, b'') or print('said')",
)
_TOP = (
    "import sys; sys.exit(0)",
    "raise KeyboardInterrupt",
    "raise GeneratorExit",
    "raise BaseException('x')",
    "raise SystemExit(3)",
    "def f(): return f()\nf()",
    "raise MemoryError",
    "MODEL = None",
    "MODEL = 1",
    "del MODEL",
    "import no_such_module",
    "(((",
    "'\\x1b[31m'.fail",
    "raise ExceptionGroup('many', [ValueError(1)])",
    "assert False, '\\x1b[31mred'",
    "1/0",
    "int('9' * 5000)",
    "raise type('E\\x1b[31m', (Exception,), {})('x')",
)


def spoiled_model(text: str, draw: random.Random) -> bytes:
    """A user's Python model that fails on loading, when it is called, or after some calls."""
    if draw.random() < 0.3:
        return f"{text}\n{draw.choice(_TOP)}\n".encode()
    if draw.random() < 0.2:
        swaps = (
            ("60.0", "1e308"),
            ("-2.0", "1e300"),
            ("8.0", "float('nan')"),
            ('"1/s"', "'ft**9**9**9'"),
            ('"roll"', "'\\x1b[31mred'"),
            ('"rad"', "'x' * 9999"),
        )
        return text.replace(*draw.choice(swaps), 1).encode()
    rates = _LATE.format(after=draw.choice((0, 30, 60, 200, 1000)), late=draw.choice(_LATER))
    begin = text.index("rates=lambda")
    return (
        text[: text.index("MODEL")]
        + rates
        + text[text.index("MODEL") : begin]
        + "rates=rates,\n    "
        + text[text.index("readings=") :]
    ).encode()
