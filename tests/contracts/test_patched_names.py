"""What tests replace by its dotted name is there: a test that runs seldom is not broken unseen."""

from __future__ import annotations

import ast
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REPLACING = ("setattr", "delattr")


def _calls() -> Iterator[tuple[str, ast.expr]]:
    """Place and first argument of each call of ``monkeypatch``'s methods."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not any(f".{name}(" in text for name in REPLACING):
            continue
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in REPLACING
                and node.args
            ):
                place = f"{path.relative_to(ROOT).as_posix()}:{node.lineno}"
                yield place, node.args[0]


CALLS = list(_calls())
NAMED = {
    place: one.value
    for place, one in CALLS
    if isinstance(one, ast.Constant) and isinstance(one.value, str)
}


@pytest.mark.parametrize("place", NAMED)
def test_a_name_that_a_test_replaces_is_there(place: str) -> None:
    pkgutil.resolve_name(NAMED[place])


def test_names_stand_in_full() -> None:
    """A name put together as the test runs could not be looked up here."""
    assert len(NAMED) > 20
    assert [place for place, one in CALLS if isinstance(one, ast.JoinedStr)] == []
