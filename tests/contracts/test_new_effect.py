"""A new effect is one new file: offered, screened, claimed, worded, drawn and listed, with nothing
else touched.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim.effects.sensor_path
from scenarios.cli.libraries import show_effects
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.diagnosis.files import write_diagnosis
from scenarios.diagnosis.text import diagnosis_text
from scenarios.diagnosis.wording import separating_maneuver
from scenarios.files.writing import write_record
from scenarios.plots.display import NamedEffects
from scenarios.plots.tracing import figure_evidence
from scenarios.preparation.plan import Request
from sim.declaration.proposal import Traceable
from sim.effects.library import find_effect, library
from sim.record import Channel
from tests.bases import RIGID_VALUES
from tests.tracing_problem import planted

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "own-effect.md"
NAME, TRUE = "vane-upwash", 0.15
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g"}


@pytest.fixture(scope="module")
def one_new_file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The effect of the documentation, in a folder that counts as one of the library's."""
    folder = tmp_path_factory.mktemp("station")
    text = PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    (folder / "vane_upwash.py").write_text(
        text.replace("EFFECTS =", "VARIANTS ="), encoding="utf-8"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sim.effects.sensor_path, "__path__", [*sim.effects.sensor_path.__path__, str(folder)]
        )
        yield folder


@pytest.fixture(scope="module")
def traced(one_new_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Tracing:
    """A diagnosis of records made with the effect, from files, by the whole loop."""
    folder = tmp_path_factory.mktemp("records")
    effect = find_effect(NAME)
    assert isinstance(effect, Traceable)
    for stem, seed in (("train", 1), ("validate", 2)):
        record = planted([effect], {f"{NAME}.upwash": TRUE}, seed)
        outputs = tuple(Channel.of(c.name, UNITS[c.name], c.values) for c in record.outputs)
        write_record(folder, replace(record, outputs=outputs, name=f"{stem}.csv"), stem)
    derivatives = {
        name: value for name, value in RIGID_VALUES.items() if name.startswith(("CL", "Cm"))
    }
    lines = [f"{name} = {value}" for name, value in RIGID_VALUES.items() if name not in derivatives]
    lines += ["[derivatives]", *(f"{name} = {1.1 * value}" for name, value in derivatives.items())]
    (folder / "vehicle.toml").write_text("\n".join(['name = "new"', *lines]), encoding="utf-8")
    return diagnose_files(
        Request(
            (folder / "train.csv",), "rigid", folder / "vehicle.toml", (folder / "validate.csv",)
        )
    )


def test_it_is_offered_and_listed(one_new_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert NAME in {effect.name for effect in library()}
    show_effects(None)
    assert NAME in capsys.readouterr().out
    show_effects(NAME)
    told = capsys.readouterr().out
    assert (
        "sensor path" in told and "upwash" in told and "plausible" in told and "  -1 to 1" in told
    )


@pytest.mark.long
def test_it_is_screened_and_claimed(traced: Tracing) -> None:
    mine = [
        candidate
        for candidate in traced.diagnosis.candidates
        if not candidate.within and candidate.name == NAME
    ]
    assert max(candidate.weight for candidate in mine if candidate.fitted) > 0.0
    (claim,) = traced.diagnosis.effects
    assert claim.name == NAME and claim.claimed
    upwash = claim.parameters["upwash"]
    assert abs(upwash.value - TRUE) < 4.0 * upwash.std < 0.05


def test_it_is_worded_by_its_own_sentence(traced: Tracing) -> None:
    assert "the control surface turns the vane: alpha + (" in diagnosis_text(traced)
    assert "jumps with the surface" in separating_maneuver("vane-offset", NAME)


@pytest.mark.long
def test_it_is_drawn_and_written(traced: Tracing, tmp_path: Path) -> None:
    d = traced.diagnosis
    figure = figure_evidence(d.candidates, NamedEffects(tuple(claim.name for claim in d.effects)))
    labels = {label.get_text() for axis in figure.axes for label in axis.get_yticklabels()}
    assert NAME in labels
    write_diagnosis(traced, tmp_path / "out")
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert [effect["name"] for effect in content["effects"]] == [NAME]
    assert content["effects"][0]["sentence"].startswith("the control surface turns the vane")
    assert (tmp_path / "out" / "evidence.png").is_file() and NAME in (
        tmp_path / "out" / "report.html"
    ).read_text(encoding="utf-8")
    assert np.isfinite(content["effects"][0]["parameters"]["upwash"]["std"])


def test_without_its_file_nothing_knows_it(one_new_file: Path) -> None:
    """Undone here, lest the fixtures above had found it elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sim.effects.sensor_path,
            "__path__",
            [path for path in sim.effects.sensor_path.__path__ if path != str(one_new_file)],
        )
        assert NAME not in {effect.name for effect in library()}
