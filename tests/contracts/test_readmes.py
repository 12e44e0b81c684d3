"""READMEs: packages with more than five files have one, it names all that is in them, and nothing
else.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("sim", "ident", "scenarios", "flightid")
SMALL = 5  # files and packages of a package that needs no README, but a docstring
PACKAGES = sorted(
    {
        path.parent
        for room in ROOMS
        for path in (ROOT / room).rglob("__init__.py")
        if "__pycache__" not in path.parts
    }
)
# Packages that were not yet brought to the rule: they keep a README though they are small, or name
# their files otherwise.
NOT_YET = ("ident/tracing", "flightid/labs")


def relative(package: Path) -> str:
    return package.relative_to(ROOT).as_posix()


def files_of(package: Path) -> set[str]:
    return {path.name for path in package.glob("*.py")} - {"__init__.py"}


RULED = [package for package in PACKAGES if not relative(package).startswith(NOT_YET)]


def content_of(package: Path) -> set[str]:
    """Files of a package, and packages in it."""
    return files_of(package) | {f"{path.name}/" for path in package.iterdir() if path in PACKAGES}


LARGE = [package for package in RULED if package.parent == ROOT or len(content_of(package)) > SMALL]


@pytest.mark.parametrize("package", LARGE, ids=relative)
def test_a_readme_names_every_file_and_package(package: Path) -> None:
    text = (package / "README.md").read_text(encoding="utf-8")
    named = {
        name
        for name in re.findall(r"^\| \[`([^`]+)`\]\(\1\) \| \S", text, re.MULTILINE)
        if name != "data/"
    }
    assert sorted(named) == sorted(content_of(package))


def test_a_small_package_has_a_docstring_and_no_readme() -> None:
    small = [package for package in RULED if package not in LARGE]
    assert len(small) > 10
    assert [relative(package) for package in small if (package / "README.md").exists()] == []
    sources = {
        relative(package): (package / "__init__.py").read_text(encoding="utf-8")
        for package in small
    }
    assert [
        name for name, source in sources.items() if not ast.get_docstring(ast.parse(source))
    ] == []
