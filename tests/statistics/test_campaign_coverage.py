"""Some campaigns of the page of measured coverage computed again: the same numbers, and the same
words.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from exam.coverage.every_scenario import PAGE, RUNS, measured

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow
AGAIN = [
    ("rigid", "main"),
    ("rigid-process-noise-b", "main"),
    ("ballistic", "one-pass"),
    ("flexible-ac1-equivalent", "no-process-noise"),
]


@pytest.mark.parametrize(("name", "method"), AGAIN)
def test_a_campaign_of_the_page_is_measured_again(name: str, method: str) -> None:
    kept = json.loads((ROOT / PAGE).with_suffix(".json").read_text(encoding="utf-8"))["campaigns"]
    page = next(each for each in kept if (each["scenario"], each["method"]) == (name, method))
    found = measured(name, method, RUNS[name, method])
    assert found["settled"] == page["settled"] and list(found["parameters"]) == list(
        page["parameters"]
    )
    for parameter, each in found["parameters"].items():
        told = page["parameters"][parameter]
        # A run in a thousand may fall on the other side of two sigmas by the last digits of another
        # machine.
        assert each["within_2"] == pytest.approx(told["within_2"], abs=2.5 / RUNS[name, method]), (
            parameter
        )
        assert ("wrong" in each) == ("wrong" in told), parameter
        if "wrong" in each:
            assert each["wrong"]["because_of"] == told["wrong"]["because_of"], parameter
            assert each["wrong"]["factor"] == pytest.approx(told["wrong"]["factor"], rel=0.02), (
                parameter
            )
