"""Names that benchmarks, examinations and the site import from the project exist."""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FOLDERS = ("benchmarks", "exam", "docs/_ext")
PROJECT = ("sim", "ident", "scenarios", "flightid", "exam")


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_name_that_is_imported_exists(folder: str) -> None:
    missing, seen = [], 0
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not node.module or node.level:
                continue
            if node.module.partition(".")[0] not in PROJECT:
                continue
            module = import_module(node.module)
            for each in node.names:
                seen += 1
                whole = f"{node.module}.{each.name}"
                if not hasattr(module, each.name) and find_spec(whole) is None:
                    missing.append(f"{path.relative_to(ROOT)}:{node.lineno}: {whole}")
    assert seen > 10 and missing == []
