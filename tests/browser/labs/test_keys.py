"""The numbers of the instructor's keys are what the labs compute at the slider values beside
them.
"""

from __future__ import annotations

import importlib
import io
import json
import re
import shlex
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

KEYS = Path(__file__).parents[3] / "flightid" / "labs" / "keys"
WORKINGS = {
    1: "falling_body",
    2: "short_period",
    3: "flexibility",
    4: "augmented",
    6: "honest_sigmas",
    8: "swept_loop",
    9: "model_structure",
}
LEFT = "as they are"


def rows(number: int) -> Iterator[tuple[dict[str, Any], dict[str, str]]]:
    """Slider values and the numbers beside them, as they are printed, of each row of a key's first
    table.
    """
    lines = [
        line
        for line in (KEYS / f"lab{number}.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    (_, *names), _, *cells = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines
    )
    for sliders, *values in cells:
        yield _settings(sliders), dict(zip(names, values, strict=True))


def _settings(text: str) -> dict[str, Any]:
    if text == LEFT:
        return {}
    pairs = re.findall(r"(\w+)=(.*?)(?:, (?=\w+=)|$)", text)
    return {name: _value(value) for name, value in pairs}


def _value(text: str) -> Any:
    if text in ("True", "False"):
        return text == "True"
    try:
        return int(text) if re.fullmatch(r"\d+", text) else float(text)
    except ValueError:
        return text


def half_a_digit(text: str) -> float:
    """Half of a printed number's last digit."""
    return 0.5 * 10.0 ** -len(text.partition(".")[2])


CASES = [
    pytest.param(number, *row, id=f"{number}: {row[0] or LEFT}")
    for number in WORKINGS
    for row in rows(number)
]


@pytest.mark.parametrize(("number", "sliders", "expected"), CASES)
def test_numbers_of_a_key(number: int, sliders: dict[str, Any], expected: dict[str, str]) -> None:
    found = importlib.import_module(f"flightid.labs.workings.{WORKINGS[number]}").key_numbers(
        **sliders
    )
    for name, text in expected.items():
        assert found[name] == pytest.approx(float(text), abs=1.001 * half_a_digit(text)), name


def test_a_wrong_number_would_be_seen() -> None:
    _, expected = next(rows(2))
    assert half_a_digit("0.108") == pytest.approx(0.0005)
    assert float(expected["largest alpha"]) == pytest.approx(11.3) and len(CASES) > 30


def test_answers_that_are_computed_are_those_of_the_keys() -> None:
    from flightid.labs.workings import augmented, falling_body, flexibility, short_period

    assert falling_body.passes_needed(550.0, 110.0) == 2
    assert falling_body.worse_prior().startswith("a narrow")
    assert (
        round(
            short_period.sigma_ratio(short_period.changes(), short_period.changes(amplitude=3.0))
            ** 2
        )
        == 4
    )
    assert short_period.longest_unit(10.0) == 0.3
    assert short_period.tuned_doublet(1.967) == pytest.approx(1.18, abs=0.01)
    assert (
        flexibility.nearer_reference(),
        flexibility.worst_derivative(),
        flexibility.first_rejected_factor(),
        flexibility.least_sufficient_density(),
    ) == ("condensed", "Cm_q", 1.5, 0.15)
    assert (augmented.level_of_delay(), augmented.most_constant()) == (
        "Level 2",
        "delay and lag together",
    )


def test_output_error_on_the_falls_of_lab_1_is_what_its_page_says() -> None:
    from flightid.labs.workings import scenario_campaign

    (line,) = (
        line.strip()
        for line in (KEYS.parent / "lab1_falling_body.py").read_text(encoding="utf-8").splitlines()
        if "estimate.method=output-error" in line
    )
    words = shlex.split(line)
    assert words[:5] == ["flightid", "campaign", "ballistic", "--runs", "200"]
    found = scenario_campaign("ballistic", tuple(words[6::2]), 200, 1)
    (spread,) = found.spreads
    assert abs(spread.bias) < spread.scatter / len(found.seeds) ** 0.5
    assert spread.reported == pytest.approx(1.5, abs=0.05)
    assert 100.0 * spread.within_two == pytest.approx(96.0, abs=0.5)


def test_the_longest_delay_of_lab_8_is_that_of_its_key() -> None:
    from flightid.labs.workings.swept_loop import longest_delay

    assert longest_delay() == 42.0 and "42 ms" in (KEYS / "lab8.md").read_text(encoding="utf-8")


def test_answers_of_lab_9_are_those_of_its_key() -> None:
    from flightid.labs.workings import model_structure as lab

    assert lab.maneuvers_needed("alpha*elevator", "Cm", 10.0) == 4
    told = lab.told(lab.study(degree=1), "Cm")
    assert len(told) == 1 and "alpha*elevator" in told[0] and "98 %" in told[0]
    linked = {row[0]: row[2] for row in lab.term_rows(lab.study(linked=True), "Cn")}
    assert linked["`rudder`"] == "-0.1256 ± 0.022" and linked["`aileron`"] == "0.01301 ± 0.013"


def test_the_command_line_of_lab_9_gives_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from flightid.labs.workings import model_structure as lab
    from scenarios.cli import main

    with zipfile.ZipFile(io.BytesIO(lab.archive(lab.study()))) as packed:
        packed.extractall(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([*shlex.split(lab.command(3, 2).replace("\\\n", " "))[1:], "--json"])
    assert ended.value.code == 0
    printed = json.loads(capsys.readouterr().out)
    numbers = lab.key_numbers()
    assert printed["coefficients"]["Cm"]["r2_left_out"] == pytest.approx(numbers["R2 left out"])
    assert printed["r2_not_fitted"]["not_fitted.csv"]["Cm"] == pytest.approx(
        numbers["R2 not fitted"]
    )


def test_secrets_of_lab_5_are_those_of_its_key() -> None:
    from flightid.labs.workings.hidden_effect import drawn, found_by_loop, residuals

    listed = re.findall(
        r"^\| (\d+) \| (.+) \|$", (KEYS / "lab5.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(listed) > 5
    assert [drawn(int(seed))[0] for seed, _ in listed] == [words for _, words in listed]
    assert found_by_loop(1) and found_by_loop(3)
    left = residuals(1)["alpha"]
    assert float(left[1:] @ left[:-1] / (left @ left)) == pytest.approx(0.90, abs=0.03)


def test_the_example_of_lab_7_is_what_its_key_says() -> None:
    from flightid.labs.workings.own_data import (
        MAP,
        checked,
        diagnosed,
        example,
        identified,
        kept,
        tried,
        vehicle_text,
    )

    given = kept(example(), vehicle_text("rigid"), MAP)
    assert any("9.1" in line and "vane" in line for line in checked(given).sentences)
    found = diagnosed(given, "rigid")
    assert [effect.name for effect in found.effects] == ["vane-offset"]
    assert all(
        abs(found[name].value - found.before[name].value) <= 1.25 * found.before[name].sigma
        for name in found.before
    )
    wrong = kept(
        example(),
        vehicle_text("rigid"),
        MAP.replace('"AoA1", unit = "deg"', '"AoA1", unit = "rad"'),
    )
    _, refused = tried(lambda: identified(wrong, "rigid"))
    assert "414 deg" in refused and refused.startswith("point_1.csv")


def test_the_log_of_lab_7_is_what_its_key_says() -> None:
    from flightid.labs.workings.own_data import (
        LOG,
        checked,
        diagnosed,
        files_of,
        identified,
        kept,
        map_of,
        vehicle_text,
    )

    given = kept(files_of(LOG), vehicle_text("rigid", LOG), map_of(LOG))
    (sentence,) = checked(given).sentences
    assert sentence.startswith("no sensor fault found")
    wrong = identified(given, "rigid")
    assert wrong["CL_q"].value < 0.0 and wrong["CL_de"].value < 0.0
    found = diagnosed(given, "rigid")
    assert [effect.name for effect in found.effects] == ["input-delay"]
    assert found.effects[0].parameters["delay"].value == pytest.approx(0.06, abs=0.003)
