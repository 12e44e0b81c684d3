"""Each folder of the simulation says in its README what lives in it; a file that comes or goes is noticed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = [ROOT / "sim", *sorted(path for path in (ROOT / "sim").rglob("*") if (path.is_dir() and any(path.glob("*.py"))) or path.name == "data")]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_readme_names_every_file_and_folder(folder: Path) -> None:
    text = (folder / "README.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| \[`([^`]+)`\]\(\1\) \| \S", text, re.MULTILINE)
    files = {path.name for path in [*folder.glob("*.py"), *folder.glob("*.toml")]} - {"__init__.py"}
    folders = {f"{path.name}/" for path in folder.iterdir() if path in FOLDERS}
    assert sorted(named) == sorted(files | folders)
    assert "\nMay import: " in text and "\nTo add: " in text
