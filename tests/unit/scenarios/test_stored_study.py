"""A model that is stored in a study folder, which may come from somebody else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scenarios.stored_study import (
    NAME,
    SCHEMA,
    StoredStudy,
    effect_content,
    effect_of,
    read_stored_study,
    vehicle_of_study,
)
from sim.effects.disturbance.gusts import GustDiscrete
from sim.errors import DeclarationError

VEHICLE = "mass = 10.0"
CONTENT = {
    "schema": SCHEMA,
    "made_by": "identify",
    "model": "ballistic",
    "vehicle_text": VEHICLE,
    "files": {},
}


def stored_file(folder: Path, **changed: object) -> StoredStudy:
    (folder / NAME).write_text(json.dumps({**CONTENT, **changed}))
    return read_stored_study(folder)


@pytest.mark.parametrize(
    "changed",
    [
        {"files": []},
        {"files": {"vehicle": {"name": 3, "sha256": ""}}},
        {"vehicle_text": None},
        {"model": 5},
    ],
)
def test_a_spoilt_model_is_one_line(tmp_path: Path, changed: dict[str, object]) -> None:
    with pytest.raises(DeclarationError, match="no model that can be read here"):
        stored_file(tmp_path, **changed)


def test_a_model_that_lacks_its_parameters_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="no model that can be read here"):
        stored_file(tmp_path).model()


@pytest.mark.parametrize(
    "name", ["../outside.toml", "/outside.toml", "..", ".", "folder/outside.toml"]
)
def test_the_vehicle_of_a_foreign_study_is_written_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    given = name.replace("/outside", f"{tmp_path}/outside", 1) if name.startswith("/") else name
    file = stored_file(
        tmp_path, files={"vehicle": {"name": given, "sha256": ""}}, vehicle_text="nothing = ["
    )
    with pytest.raises(DeclarationError, match="TOML"):
        vehicle_of_study(file, None)
    assert {path.name for path in tmp_path.rglob("*")} == {"scratch", NAME}


def test_an_effect_kept_by_an_older_version_is_made_again() -> None:
    """Its class may have been in another file then; a class that is nowhere is refused."""
    effect = GustDiscrete()
    content = effect_content(effect)
    older = {**content, "class": "sim.effects.disturbance.gust_discrete:GustDiscrete"}
    assert effect_of(older, (), "study") == effect == effect_of(content, (), "study")
    for place in ("gust_discrete:GustOfNobody", "gusts:GustOfNobody"):
        gone = {**content, "class": f"sim.effects.disturbance.{place}"}
        with pytest.raises(DeclarationError, match="cannot be made again"):
            effect_of(gone, (), "study")
