"""Three causes at once: the least of them is seen by a search that keeps more sets."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.oracles import undeclared_flights as flights
from tests.oracles.undeclared_flights import LINER, SIGMA, Hidden
from tests.undeclared.cases import Case, always, diagnosed, one, write_case

THREE = Case(
    "dead band, vane and load scale",
    LINER,
    always(
        Hidden(command=(flights.dead(0.006),), vane_arm=7.0, sensors={"nz": flights.scaled(1.08)})
    ),
    one("input-deadband", "vane-offset", "sensor-scale:nz"),
    parameters={
        "input-deadband.half_width": 0.006,
        "vane-offset.arm": 7.0,
        "sensor-scale:nz.scale": 1.08,
    },
    seed=13,
)


@pytest.mark.slow
def test_a_thorough_search_names_the_three_causes_that_a_normal_one_does_not(
    tmp_path: Path,
) -> None:
    write_case(THREE, tmp_path)
    normal, thorough = (
        diagnosed(tmp_path, "rigid", SIGMA, effort) for effort in ("normal", "thorough")
    )
    assert normal.claimed not in THREE.names
    assert thorough.content["verdict"] == "traced" and thorough.claimed in THREE.names
    assert thorough.content["effort"]["name"] == "thorough"
    for name, true in THREE.parameters.items():
        value, std = thorough.quantity(name)
        assert abs(value - true) < 4.0 * std, name
    assert max(thorough.after.values()) < 1.15
