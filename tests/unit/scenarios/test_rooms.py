"""Every folder says what lives in it, file by file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3] / "scenarios"
FOLDERS = [ROOT, *sorted(path.parent for path in ROOT.rglob("__init__.py") if path.parent != ROOT), ROOT / "catalog"]


def inhabitants(folder: Path) -> list[str]:
    """Modules and folders that a README has to name."""
    modules = [path.name for path in folder.glob("*.py") if not path.stem.startswith("__")]
    return sorted([*modules, *(path.name for path in folder.iterdir() if path.is_dir() and (path / "__init__.py").exists())])


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT.parent)))
def test_a_folders_readme_names_all_that_lives_in_it_and_nothing_else(folder: Path) -> None:
    said = re.findall(r"`([\w/.:-]+)`", (folder / "README.md").read_text(encoding="utf-8"))
    named = {word.rstrip("/") for word in said}
    missing = [name for name in inhabitants(folder) if name not in named and name.removesuffix(".py") not in named]
    assert not missing, f"{folder.name}/README.md does not name {missing}"
    # A file that is named and is not there was moved away.
    for word in (word for word in named if word.endswith(".py")):
        assert any((place / word).exists() for place in (folder, ROOT, ROOT.parent, folder.parent)), f"{folder.name}/README.md names {word}"
