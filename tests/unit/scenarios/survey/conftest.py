"""A survey whose flights are made up: nothing is read of a record but its name, and what is
computed is counted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from scenarios.files.writing import write_json
from scenarios.report.figure_formats import Formats
from scenarios.survey import flights as one_flight
from scenarios.survey import growing
from scenarios.survey.files import write_survey
from scenarios.survey.flights import SurveyFlight
from scenarios.survey.survey import SurveyResult, survey_flights
from sim.errors import FlightidError
from tests.integration.command_line import VEHICLE
from tests.unit.scenarios.survey.made_up import flown, kept


class Campaign:
    """A test campaign in a folder: ``late`` flights have a late channel. ``diagnosed`` and
    ``fitted``: of which flights, in turn.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "morning"
        self.diagnosed: list[str] = []
        self.fitted: list[str] = []
        self.stop_at, self.faults = "", dict[str, Exception]()
        (folder / "aircraft.toml").write_text(VEHICLE)

    def fly(self, name: str, late: float = 0.0, more: str = "") -> str:
        """A record, and the flight's table."""
        (self.folder / f"{name}.csv").write_text(f"{late}")
        return f'[[flights]]\nrecord = "{name}.csv"\n{more}\n'

    def declare(self, *flights: str) -> Path:
        file = self.folder / "flights.toml"
        file.write_text(
            'title = "made up"\nmodel = "rigid"\nvehicle = "aircraft.toml"\n' + "".join(flights)
        )
        return file

    def survey(self, *flights: str) -> SurveyResult:
        """A survey of these, written; what was diagnosed before is forgotten."""
        self.diagnosed.clear()
        self.fitted.clear()
        found = survey_flights(self.declare(*flights), self.out)
        write_survey(found, self.out, figures=())
        return found


def late_of(flight: SurveyFlight) -> float:
    return float(flight.records[0].read_text())


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    made = Campaign(tmp_path)

    def diagnosed(flight: SurveyFlight, folder: Path, figures: Formats) -> dict[str, Any]:
        if flight.name == made.stop_at:
            raise KeyboardInterrupt
        if flight.name in made.faults:
            raise made.faults[flight.name]
        if not flight.records[0].is_file():
            raise FlightidError(
                "there is no such file", where=str(flight.records[0]), remedy="check the path"
            )
        made.diagnosed.append(flight.name)
        (told,) = kept([{"sensor-delay:q": ["sensor-lag:q"]} if late_of(flight) else {}]).values()
        content = {
            "schema": one_flight.SCHEMA,
            "digest": flight.digest,
            "name": flight.name,
            **told,
        }
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / one_flight.KEPT, content)
        return content

    def fitted_sets(
        flight: SurveyFlight, names: tuple[str, ...], starts: object, own: object
    ) -> dict[str, Any]:
        import numpy as np

        made.fitted.append(flight.name)
        rng = np.random.default_rng(list(flight.name.encode()))
        late = late_of(flight)
        return flown(
            rng,
            {name: rng.standard_normal((60, 1)) for name in names},
            {"sensor-delay:q": [late]} if late and names else {},
        ).fits()

    monkeypatch.setattr(one_flight, "diagnosed", diagnosed)
    monkeypatch.setattr(growing, "fitted_sets", fitted_sets)
    return made
