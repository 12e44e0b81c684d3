"""Clean records of every model: the bound against closed forms, flights that depend on their seed,
rows that count.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exam.clean import MODELS, CleanRun, clean_rows
from exam.random_cases.examination import write_clean
from scenarios.report.terminal import cell_text
from scenarios.studies.campaign_statistics import cramer_rao
from sim.declaration import own_model
from sim.declaration.model import Model
from sim.record import Channel, Record

TIME = np.arange(0.0, 4.0, 0.1)


def falling() -> Model:
    """A height that sinks steadily from where it begins."""
    return own_model(
        name="sinking",
        states={"height": "m"},
        inputs={},
        outputs={"height": "m"},
        parameters={"sink": (2.0, "m/s")},
        rates=lambda s, p: {"height": -p.sink},
        readings=lambda s, p: {"height": s.height},
    )


def flown(model: Model) -> Record:
    height = model.initial.values()[0] - model.parameters["sink"].value * TIME
    return Record(TIME, (), (Channel.of("height", "m", height),))


def test_the_bound_of_a_straight_line_is_that_of_textbooks() -> None:
    """sigma / sqrt(sum (t - mean t)^2); where it begins and a bias of the sensor are one
    unknown.
    """
    expected = 0.3 / np.sqrt(np.sum((TIME - TIME.mean()) ** 2))
    for biased in ({}, {"height": np.inf}, {"height": 0.1}):
        assert cramer_rao(falling(), flown, {"height": 0.3}, ("sink",), biased)[
            "sink"
        ] == pytest.approx(expected, rel=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("model", ["rigid", "loes", "ballistic"])
def test_a_clean_case_hides_nothing_and_depends_on_its_seed(model: str, tmp_path: Path) -> None:
    texts = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        written, flight = write_clean(model, 3, tmp_path / name)
        texts.append(
            [
                (tmp_path / name / file).read_text()
                for file in ("train.csv", "validate.csv", "vehicle.toml")
            ]
        )
        assert written.case.hidden == () and written.request.model == model
        assert (
            flight.setting.model.parameters.values().tolist()
            == written.model.parameters.values().tolist()
        )
    assert texts[0] == texts[1]


def test_rows_count_by_model_and_together() -> None:
    runs = [
        CleanRun(
            1,
            "rigid",
            "consistent",
            (),
            (),
            {"Cm_q": 1.0, "CL_q": -2.5},
            {"Cm_q": 1.0, "CL_q": 1.2},
            1.0,
        ),
        CleanRun(2, "own", "traced", ("sensor-delay:x",), (), {"gain": 0.1}, {"gain": 0.9}, 2.0),
    ]
    rows = {str(row[0]): [cell_text(cell) for cell in row] for row in clean_rows(runs)}
    assert set(rows) == {"rigid", "own", "all"} and set(rows) - {"all"} <= set(MODELS)
    assert rows["own"][1:3] == ["1", "1"] and rows["own"][4] == "1" and rows["rigid"][2] == "0"
    assert (
        rows["rigid"][5].startswith("50.0 of 2 (")
        and rows["all"][5].startswith("66.7 of 3 (")
        and rows["all"][6].startswith("1.00 (")
    )
