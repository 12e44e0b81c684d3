"""Mistakes in a user's own model, its vehicle file and the words of its flight: one line, exit code
2 and nothing written, by every command.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from typer.main import get_command

from scenarios import cli
from tests.integration.command_line import CommandLine, contents
from tests.own_models import SPRING

FILE = "my_model.py"
SCENARIO = """schema = "flightid/scenario/1"
title = "a spring"
distance = "same equations, finer step"
[flight]
vehicle = "my_model.py"
duration = 2.0
rate = 50.0
noise_std = {x = 0.001}
[estimate]
model = "my_model.py"
"""
TRACE = """schema = "flightid/scenario/1"
kind = "trace"
title = "a spring"
distance = "nothing missing"
[flight]
vehicle = "my_model.py"
noise_std = {x = 0.001}
train = {duration = 2.0}
validate = {duration = 1.0}
[estimate]
model = "my_model.py"
[expect]
verdicts = ["consistent"]
"""
COMMANDS: dict[str, tuple[str, ...]] = {
    "identify": ("identify", "record.csv", "--model", FILE, "--out", "out"),
    "diagnose": ("diagnose", "record.csv", "--model", FILE, "--out", "out"),
    "simulate": ("simulate", "--model", FILE, "--out", "new.csv"),
    "campaign": ("campaign", "--model", FILE, "--runs", "2", "--out", "out"),
    "models": ("models", FILE),
    "run": ("run", "mine.toml", "--out", "out"),
    "run of a trace": ("run", "trace.toml", "--out", "out"),
}


def swapped(*pairs: tuple[str, str]) -> str:
    """The spring with some of its text replaced."""
    text = SPRING
    for before, after in pairs:
        assert before in text
        text = text.replace(before, after)
    return text


def beside_rates(text: str) -> str:
    return swapped(("    rates=", f"    {text},\n    rates="))


RATES, FLOW = (
    'rates=lambda s, p: {"x": s.v, "v": s.a}',
    '"a": (s.force - p.c * s.v - p.k * s.x) / p.m',
)
# Text of the file, and how its line begins; the call of own_model stands in line 5.
FILES: dict[str, tuple[str, str]] = {
    "a signal that is not there": (
        swapped((RATES, RATES.replace("s.v", "s.vel"))),
        "line 5: model spring-mass, rates (my_model.py, line 13): there is no signal s.vel",
    ),
    "a parameter that is not there": (
        swapped(("p.k *", "p.kk *")),
        "line 5: model spring-mass, flow (my_model.py, line 12): there is no parameter p.kk; did "
        "you mean 'k'?",
    ),
    "too few rates": (
        swapped((RATES, RATES.replace('"x": s.v, ', ""))),
        "line 5: model spring-mass, rates (my_model.py, line 13): x missing; ",
    ),
    "rates as a list": (
        swapped((RATES, "rates=lambda s, p: [s.v, s.a]")),
        "line 5: model spring-mass, rates (my_model.py, line 13): it returns a list",
    ),
    "a reading too many": (
        swapped(('"acceleration": s.a}', '"acceleration": s.a, "y": 0.0}')),
        "line 5: model spring-mass, readings (my_model.py, line 14): there is no output 'y'; ",
    ),
    "no number at the starts": (
        swapped(('"x": s.v', '"x": s.v + float("nan")')),
        "line 5: model spring-mass, rates (my_model.py, line 13): the rate of x is nan at the "
        "starts; ",
    ),
    "a rate of another shape": (
        swapped(('"x": s.v', '"x": np.ones(3)'), ("from sim", "import numpy as np\nfrom sim")),
        "line 6: model spring-mass, rates (my_model.py, line 14): the rate of x of shape (3,) "
        "where all signals are single numbers; ",
    ),
    "a function of s alone": (
        swapped((RATES, RATES.replace("s, p", "s"))),
        "line 5: model spring-mass, rates (my_model.py, line 13): it takes (s), not (s, p); ",
    ),
    "a function of three": (
        swapped(("readings=lambda s, p", "readings=lambda s, p, t")),
        "line 5: model spring-mass, readings (my_model.py, line 14): it takes (s, p, t)",
    ),
    "a function that loses derivatives": (
        swapped(("p.c * s.v", "p.c * s.v.real")),
        "line 5: model spring-mass, rates (my_model.py, line 13): the rate of v loses a complex "
        "step",
    ),
    "a parameter in no equation": (
        swapped(('"c": (1.0, "N s/m")', '"c": (1.0, "N s/m"), "d": (1.0, "1")')),
        "line 11: model spring-mass, parameters, d: it is in no equation; ",
    ),
    "a start of another state": (
        beside_rates('initial={"y": 1.0}'),
        "line 5: model spring-mass, initial: there is no state 'y'; use one of x, v, force",
    ),
    "bounds of another parameter": (
        beside_rates('bounds={"kk": (0, 1)}'),
        "line 5: model spring-mass, bounds: there is no parameter 'kk'; ",
    ),
    "a start beyond its bounds": (
        beside_rates('bounds={"k": (0, 1)}'),
        "line 5: parameter k: value 50 N/m lies outside [0, 1]; ",
    ),
    "a unit that is no text": (
        swapped(('"force": "N"', '"force": 3')),
        "line 5: model spring-mass, inputs, force: the unit is of type int; ",
    ),
    "a state read in another unit": (
        swapped(('outputs={"x": "m"', 'outputs={"x": "mm"')),
        "line 5: model spring-mass, outputs, x: the unit is mm, that of the state",
    ),
    "one name for two things": (
        swapped(('inputs={"force": "N"}', 'inputs={"x": "N"}')),
        "line 5: model spring-mass, inputs: 'x' is among the states as well; ",
    ),
    "a start that is no number": (
        swapped(("(50.0,", '("50",')),
        "line 5: model spring-mass, parameters, k: '50' is no number; ",
    ),
    "an argument that is not there": (
        swapped(("parameters=", "params=")),
        "line 5: TypeError: own_model() got an unexpected keyword argument 'params'; ",
    ),
    "a division by zero": (
        swapped(("(2.0,", "(0.0,")),
        "line 5: model spring-mass, flow (my_model.py, line 12): ZeroDivisionError: ",
    ),
    "another package that is not there": (
        "import nothing_there\n" + SPRING,
        "line 1: ModuleNotFoundError: No module named 'nothing_there'; ",
    ),
    "no Python": (
        SPRING.replace("states={", "states={{"),
        "line 15: SyntaxError: closing parenthesis ')' does not match",
    ),
    "no model": (SPRING.replace("MODEL", "MODL"), "it declares no MODEL; "),
    "a name that is built in": (
        SPRING.replace('"spring-mass"', '"rigid"'),
        "the model 'rigid' is built in; ",
    ),
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder: a record, a scenario of each kind, and the model as it should be."""
    rows = "\n".join(f"{0.02 * k:.2f},{float(k % 9 > 4)},{0.001 * (k % 7)},0.1" for k in range(60))
    (tmp_path / "record.csv").write_text(f"time,force,x,acceleration\n{rows}\n")
    (tmp_path / "mine.toml").write_text(SCENARIO)
    (tmp_path / "trace.toml").write_text(TRACE)
    (tmp_path / FILE).write_text(SPRING)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "app", parser())
    return tmp_path


@cache
def parser() -> object:
    """The command line's parser, made once for all calls of this file: that takes longer than a
    refusal.
    """
    return get_command(cli.app)


@pytest.mark.long
@pytest.mark.parametrize("case", FILES)
def test_a_wrong_model_file_is_told_alike_by_every_command(
    flightid: CommandLine, place: Path, case: str
) -> None:
    text, line = FILES[case]
    (place / FILE).write_text(text)
    before = contents(place)
    (told,) = {flightid.refused(*arguments) for arguments in COMMANDS.values()}
    assert told.startswith(f"{FILE}, {line}" if line.startswith("line") else f"{FILE}: {line}"), (
        told
    )
    assert contents(place) == before


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("mass = 3\n", "key mass: there is no such key; use one of m"),
        ('m = "3 N"\n', "key m: unit 'N' does not measure a mass; "),
        ("k = 3\n", "key k: there is no such key; it is a parameter: put it under [derivatives]"),
        ("[derivatives]\nk = nan\n", "key derivatives.k: value nan is not a finite number; "),
        (
            "[derivatives]\nm = 3\n",
            "key derivatives.m: there is no such key; it is a constant: put it above [derivatives]",
        ),
    ],
)
def test_a_vehicle_file_that_contradicts_the_declaration(
    flightid: CommandLine, place: Path, text: str, line: str
) -> None:
    (place / "other.toml").write_text(text)
    before = contents(place)
    commands = [COMMANDS[name] for name in ("identify", "diagnose", "simulate", "campaign")]
    (told,) = {flightid.refused(*arguments, "--vehicle", "other.toml") for arguments in commands}
    assert told.startswith(f"other.toml, {line}") and contents(place) == before


WORDS: list[tuple[tuple[str, ...], str]] = [
    (
        ("--input", "frce=doublet"),
        "--input frce=doublet: there is no input 'frce'; its inputs are force",
    ),
    (
        ("--input", "force=doblet"),
        "--input force=doblet: there is no maneuver 'doblet'; did you mean 'doublet'?",
    ),
    (("--input", "force"), "--input force: this is not INPUT=KIND; "),
    (
        ("--input", "force=doublet,amplitude"),
        "--input force=doublet,amplitude: 'amplitude' is not KEY=VALUE; ",
    ),
    (
        ("--input", "force=doublet,amplitude=3 kg"),
        "--input force=doublet,amplitude=3 kg, amplitude: unit 'kg' does not measure a force; ",
    ),
    (
        ("--input", "force=doublet,amplitude=inf"),
        "--input force=doublet,amplitude=inf: amplitude=inf is no finite number; ",
    ),
    (
        ("--input", "force=doublet,duration=3"),
        "--input force=doublet,duration=3: a doublet takes no duration; ",
    ),
    (("--input", "force=doublet,unit=0 s"), "--input force=doublet,unit=0 s: a step lasts 0 s; "),
    (
        ("--input", "force=multisine,harmonics=3"),
        "--input force=multisine,harmonics=3: harmonics=3 is no list; ",
    ),
    (("--noise", "y=1"), "--noise y=1: there is no output 'y'; use one of x, acceleration"),
    (("--noise", "x=-1"), "--noise x=-1: -1 is not above 0; "),
    (("--noise", "x"), "--noise x: this is not OUTPUT=SIZE; "),
    (("--duration", "0.01"), "--duration: no maneuver begins within 0.01 s; "),
    (("--duration", "-1"), "--duration: -1 is not above 0; "),
    (("--rate", "0"), "--rate: 0 is not above 0; "),
    (("--rate", "1e9"), "--duration, --rate: "),
    (("--model", "rigid"), "--model: the model 'rigid' is built in; "),
    (("--model", "rigidd"), "--model: there is no model 'rigidd'; "),
    (("--model", "gone.py"), "gone.py: there is no such file; "),
    (("--vehicle", "gone.toml"), "gone.toml: there is no such file; "),
    (("--set", "flight.foo=1"), "my_model.py, key flight.foo: there is no such key; "),
    (
        ("--set", "estimate.model=rigid"),
        "my_model.py, key estimate.model: a model of your own flies, and rigid is fitted; ",
    ),
    (
        ("--set", "flight.values.kk=3"),
        "my_model.py, key flight.values.kk: there is no parameter 'kk'; did you mean 'k'?",
    ),
    (("--set", "flight.modes=2"), "my_model.py, key flight.modes: 2 elastic modes asked for; "),
    (("lateral",), "--model: a scenario is named as well, 'lateral'; "),
]


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("options", "line"), WORDS, ids=[" ".join(options) for options, _ in WORDS]
)
def test_a_wrong_word_of_a_flight(
    flightid: CommandLine, place: Path, options: tuple[str, ...], line: str
) -> None:
    before = contents(place)
    for name in ("simulate", "campaign"):
        assert flightid.refused(*COMMANDS[name], *options).startswith(line)
    assert contents(place) == before


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            ("--hide", "sensor-dely:x.delay=1"),
            "--hide sensor-dely:x.delay=1: there is no effect 'sensor-dely:x' on spring-mass; did "
            "you mean",
        ),
        (
            ("--hide", "sensor-delay:x.dly=1"),
            "--hide sensor-delay:x.dly=1: sensor-delay:x has no 'dly'; did you mean 'delay'?",
        ),
        (
            ("--hide", "sensor-delay:x.delay=1 m"),
            "--hide sensor-delay:x.delay=1 m: unit 'm' does not measure a time; ",
        ),
        (
            ("--hide", "sensor-delay:x.delay=-1"),
            "my_model.py, parameter sensor-delay:x.delay: value -1 s lies outside",
        ),
        (
            ("--hide", "delay=1"),
            "--hide delay=1: there is no effect '' on spring-mass; write EFFECT.PARAMETER=VALUE",
        ),
        (
            ("--set", "hidden=[{name='own:none'}]"),
            "my_model.py, key hidden[1].name: there is no term 'own:none' for spring-mass; ",
        ),
    ],
)
def test_a_wrong_hidden_effect(
    flightid: CommandLine, place: Path, options: tuple[str, ...], line: str
) -> None:
    before = contents(place)
    assert flightid.refused(*COMMANDS["simulate"], *options).startswith(line)
    assert contents(place) == before


def edited(text: str, *pairs: tuple[str, str]) -> Callable[[Path], None]:
    """Writes a scenario with some of its text replaced."""

    def write(path: Path) -> None:
        out = text
        for before, after in pairs:
            assert before in out
            out = out.replace(before, after)
        path.write_text(out)

    return write


MODEL = '[estimate]\nmodel = "my_model.py"'


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("write", "line"),
    [
        (
            edited(SCENARIO, (MODEL, '[estimate]\nmodel = "rigid"')),
            "mine.toml, key estimate.model: a model of your own flies, and rigid is fitted; ",
        ),
        (
            edited(SCENARIO, (MODEL, '[estimate]\nmodel = "gone.py"')),
            "gone.py: there is no such file; ",
        ),
        (
            edited(SCENARIO, (MODEL, f"{MODEL}\nstart = {{kk = {{value = 1, std = 1}}}}")),
            "mine.toml, estimation main, key start: there is no parameter 'kk'; ",
        ),
        (
            edited(SCENARIO, (MODEL, f"{MODEL}\nheld = {{kk = 1}}")),
            "mine.toml, estimation main, key held: there is no parameter 'kk'; ",
        ),
        (
            edited(SCENARIO, (MODEL, f"{MODEL}\ninitial = {{y = {{value = 1, std = 1}}}}")),
            "mine.toml, estimation main, key initial: there is no state 'y'; ",
        ),
        (
            edited(SCENARIO, (MODEL, f'{MODEL}\nstart = {{k = {{value = "1 kg", std = 1}}}}')),
            "mine.toml, key estimate.start.k.value: unit 'kg' does not ",
        ),
        (
            edited(SCENARIO, (MODEL, f'{MODEL}\noutputs = ["y"]')),
            "mine.toml, estimation main, key outputs: there is no output 'y'; ",
        ),
        (
            edited(SCENARIO, ("{x = 0.001}", "{y = 0.001}")),
            "mine.toml, key flight.noise: there is no output 'y'; ",
        ),
        (
            edited(
                SCENARIO,
                ('"my_model.py"\nduration', '"bomber_rigid"\nvalues = {k = 1.0}\nduration'),
            ),
            "mine.toml, key flight.values: a built-in vehicle has ",
        ),
        (
            edited(TRACE, ('"my_model.py"\nnoise', '"bomber_rigid"\nnoise')),
            "mine.toml, key estimate.model: the built-in vehicle bomber_rigid flies; ",
        ),
        (
            edited(SCENARIO, ("duration", "derivatives = {k = 3.0}\nduration")),
            "mine.toml, key flight.derivatives: a model of your own has no ",
        ),
        (
            edited(SCENARIO, ("[flight]", 'aircraft_class = "II"\n[flight]')),
            "mine.toml, key aircraft_class: this is for aircraft, and none flies",
        ),
        (
            edited(SCENARIO, ("[flight]", "condensed = true\n[flight]")),
            "mine.toml, key condensed: this is for aircraft, and none flies",
        ),
        (
            edited(SCENARIO, ("duration = 2.0", "duration = nan")),
            "mine.toml, key flight.duration: value nan is not a finite number; ",
        ),
        (
            edited(TRACE, (MODEL, f"{MODEL}\nstart = {{kk = 1.0}}")),
            "mine.toml, key estimate.start: there is no kk; use k, c",
        ),
    ],
)
def test_a_wrong_scenario_of_an_own_model(
    flightid: CommandLine, place: Path, write: Callable[[Path], None], line: str
) -> None:
    write(place / "mine.toml")
    before = contents(place)
    assert flightid.refused(*COMMANDS["run"]).startswith(line)
    assert contents(place) == before


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("simulate", "--out", "new.csv"), "nothing is named; name a scenario"),
        (("campaign", "--runs", "2"), "nothing is named; name a scenario"),
        (
            ("simulate", "rigid", "--noise", "q=1", "--out", "new.csv"),
            "--noise: this goes with --model FILE.py; ",
        ),
        (("simulate", "--model", FILE, "--out", "new.txt"), "new.txt: .txt ending; "),
        (
            (
                "identify",
                "record.csv",
                "--model",
                FILE,
                "--out",
                "out",
                "--state-space",
                "out/comparison.json",
            ),
            "--state-space, out/comparison.json: the matrices would take the place of",
        ),
        (
            ("identify", "record.csv", "--model", FILE, "--class", "I"),
            "--class: spring-mass is no model of an aircraft",
        ),
        (
            ("diagnose", "record.csv", "--model", FILE, "--category", "A"),
            "--category: spring-mass is no model of an aircraft",
        ),
        (("models", FILE, "--example"), "--example: a model is named as well, 'my_model.py'; "),
    ],
)
def test_calls_that_say_too_little_or_too_much(
    flightid: CommandLine, place: Path, arguments: tuple[str, ...], line: str
) -> None:
    before = contents(place)
    assert flightid.refused(*arguments).startswith(line)
    assert contents(place) == before


def test_an_answer_that_is_lost_on_the_way(flightid: CommandLine, place: Path) -> None:
    """At the starts there is a number; where the motion leaves the root's range there is none."""
    (place / FILE).write_text(
        swapped(
            ('"x": s.v', '"x": s.v + 0 * sqrt(0.01 - s.x)'),
            ("from sim", "from sim.maths import sqrt\nfrom sim"),
        )
    )
    before = contents(place)
    for name in ("simulate", "campaign"):
        assert "the simulation diverges at " in flightid.refused(
            *COMMANDS[name], "--input", "force=step,amplitude=5"
        )
    assert contents(place) == before
