"""What results say of themselves: one short line, a table for a notebook that shows any text as it
stands, numbers by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any

import pandas
import pytest

import flightid as fid
from ident.tracing.diagnosis import Verdict
from scenarios.api import tables
from scenarios.api.shown import Parameter, write_sheets
from tests.diagnoses import diagnosis_of, measured_record, spread_tracing, tracing_of

SHORT = 1000  # letters
VERDICTS = [*Verdict]


class Balanced(HTMLParser):
    """Whether all that is opened is closed, in order; the texts between."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def shown(text: str) -> list[str]:
    """The texts of an HTML fragment, which is whole."""
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    return parser.texts


@pytest.mark.sampled
@pytest.mark.parametrize("verdict", VERDICTS, ids=lambda each: each.value)
def test_a_diagnosis_of_every_verdict(verdict: Verdict) -> None:
    tracing = tracing_of(verdict)
    found = fid.Diagnosis(tracing)
    claimed = [claim.name for claim in tracing.diagnosis.effects if claim.claimed]
    assert (
        found.verdict == verdict.value
        and found.sentence == verdict.sentence
        and [each.name for each in found.effects] == claimed
    )
    assert [each.name for each in found.hints] == [
        claim.name for claim in tracing.diagnosis.effects if not claim.claimed
    ]
    assert verdict.value in repr(found) and all(name in repr(found) for name in claimed)
    assert f"{verdict.value.upper()}: {found.headline}" in shown(found._repr_html_())
    assert tracing.vehicle.name in found.summary() and "save(FOLDER) keeps them" in found.summary()
    table = found.to_dataframe()
    assert {name: value for name, value in table["value_after"].items()} == {
        n: q.value for n, q in tracing.diagnosis.after.items()
    }
    assert {name: value for name, value in table["sigma_before"].items()} == {
        n: q.std for n, q in tracing.diagnosis.before.items()
    }
    assert set(found.error_before) == set(found.error_after) and len(found.candidates()) == len(
        tracing.diagnosis.candidates
    )
    for each in (
        found,
        found.parameters,
        *found.effects,
        *found.hints,
        *found.records,
        tracing,
        tracing.diagnosis,
    ):
        assert len(repr(each)) < SHORT and "\n" not in repr(each)


def test_effects_carry_their_numbers_and_what_would_do_as_well() -> None:
    found = fid.Diagnosis(tracing_of(Verdict.AMBIGUOUS))
    (effect,) = found.effects
    assert (effect["delay"].value, effect["delay"].sigma, effect["delay"].unit) == (
        0.061,
        0.001,
        "s",
    )
    assert effect.alternatives == ("actuator-lag",) and "actuator-lag" in "".join(
        shown(effect._repr_html_())
    )
    proven = fid.Diagnosis(spread_tracing())
    assert proven.effects and len(repr(proven)) < SHORT
    with pytest.raises(KeyError, match="there is no estimated parameter 'lag': delay"):
        _ = effect["lag"]
    with pytest.raises(fid.InputError, match=r"a workbook cannot be named a\.csv; name a \.xlsx"):
        write_sheets("a.csv", {})


def test_figures_are_those_of_the_study_and_asked_for_by_name() -> None:
    found = fid.Diagnosis(tracing_of(Verdict.TRACED))
    assert found.plot.residuals().axes and fid.plot.evidence(found).axes
    assert "residuals" in dir(found.plot) and "residuals" in repr(found.plot)
    with pytest.raises(AttributeError, match="there is no figure 'fit': residuals"):
        found.plot.fit()
    with pytest.raises(fid.InputError, match="there is no figure residuals_9"):
        found.plot.residuals(8)


@pytest.mark.parametrize(
    ("parameter", "text", "known"),
    [
        (fid.Parameter("Cm_q", -34.83, 0.0957, "1/rad"), "Cm_q = -34.830 +- 0.096 1/rad", True),
        (fid.Parameter("scale", 1.0624, 0.0031, "1"), "scale = 1.0624 +- 0.0031", True),
        (fid.Parameter("delay", 0.2, 0.0, "s"), "delay = 0.2 s (bound)", False),
        (fid.Parameter("lift", 1.0, 2.64e4, "1"), "lift = not determined", False),
        (fid.Parameter("lift", 1.0, math.inf, "1"), "lift = not determined", False),
    ],
)
def test_a_parameter_is_printed_with_the_digits_that_it_has(
    parameter: fid.Parameter, text: str, known: bool
) -> None:
    assert (
        repr(parameter) == text
        and parameter.determined is known
        and float(parameter) == parameter.value
    )


def test_parameters_are_a_mapping_in_their_order() -> None:
    items = [
        fid.Parameter(f"p{number}", float(number), 0.1, "1", start=2.0 if number else None)
        for number in range(40)
    ]
    some = fid.Parameters(items)
    assert (
        list(some) == [item.name for item in items]
        and some["p3"] is items[3]
        and len(some) == 40
        and "p41" not in some
    )
    assert (
        some.to_dict()["p7"] == 7.0
        and len(repr(some)) < SHORT
        and len(fid.Parameters([]).to_dataframe()) == 0
    )
    table = some.to_dataframe()
    assert table.loc["p5", ["value", "sigma", "start"]].tolist() == [5.0, 0.1, 2.0] and math.isnan(
        table.loc["p0", "start"]
    )
    assert "p39" in shown(some._repr_html_())


@pytest.mark.sampled
@pytest.mark.parametrize(
    "table", [fid.effects, fid.models, fid.vehicles, fid.scenarios], ids=lambda each: each.__name__
)
def test_libraries_are_tables(table: type) -> None:
    rows = table()
    assert (
        len(repr(rows)) < SHORT
        and len(rows) == len(rows.to_dataframe()) == len(list(rows)) == len(set(rows.names)) > 5
    )
    assert rows.names[0] in str(rows) and rows.names[-1] in shown(rows._repr_html_())
    assert rows[rows.names[1]] == list(rows)[1] and isinstance(
        rows.to_dataframe(), pandas.DataFrame
    )
    with pytest.raises(KeyError, match="there is no 'nothing'"):
        _ = rows["nothing"]


def test_any_text_stands_in_a_page_as_it_is() -> None:
    rude = "<script>alert('&')</script>"
    assert (
        shown(tables.page(rude, tables.sentences([rude]), tables.table([rude], [[rude]]))).count(
            rude
        )
        == 4
    )
    record = fid.read_record({"time": [0.0, 1.0], rude: [1.0, 2.0], "alpha": ["x", 1.0]}, name=rude)
    texts = shown(record._repr_html_())
    assert (
        rude in texts
        and any("'x' is not a number" in text for text in texts)
        and len(repr(record)) < SHORT
    )


def test_the_longest_names_leave_a_repr_short() -> None:
    record = measured_record()
    tracing = tracing_of(Verdict.CONSISTENT)
    found = diagnosis_of(Verdict.CONSISTENT, tracing.vehicle, (record,) * 60, (record,) * 60)
    assert len(repr(found)) < SHORT
    columns = {"time": [0.0, 1.0], **{f"{'x' * 40}{number}": [0.0, 1.0] for number in range(60)}}
    assert len(repr(fid.read_record(columns))) < SHORT


@pytest.mark.parametrize(
    ("value", "sigma", "ends"), [(1.0, 0.1, (0.8, 1.2)), (-3.0, 0.5, (-4.0, -2.0))]
)
def test_the_interval_of_a_parameter_is_two_sigmas_to_either_side(
    value: float, sigma: float, ends: tuple[float, float]
) -> None:
    found = Parameter("Cm_q", value, sigma, "1/rad")
    assert found.interval == pytest.approx(ends) and float(found) == value


def wrong(value: Any) -> Any:
    """A value of a type that annotations forbid."""
    return value


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: fid.simulate("rigid", set=wrong(3)), "set: 3 names no setting"),
        (lambda: fid.design("rigid", "bomber_rigid", tell=wrong(3)), "tell: 3 names no effect"),
        (lambda: fid.survey(wrong(3)), "a int is no path"),
        (lambda: fid.vehicle("bomber_rigid").save(wrong(3)), "a int is no path"),
        (lambda: fid.vehicle("bomber_rigid").save("no-folder/v.toml"), "there is no folder"),
        (lambda: fid.estimators.ekf(wrong({"time": [0.0]}), "rigid"), "a dict is no model"),
    ],
)
def test_wrong_paths_and_texts_are_refused_in_one_line(
    call: Callable[[], object], said: str
) -> None:
    with pytest.raises(fid.InputError, match=said) as raised:
        call()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: fid.check({}, trust_record=wrong("yes")), "trust_record: 'yes' is neither True"),
        (lambda: fid.check({}, rate=wrong("fast")), "rate: 'fast' is no number"),
        (lambda: fid.check({}, columns=wrong(3)), "columns: 3 names no column"),
        (
            lambda: fid.check({"time": [0.0, 1.0], "q": [0.0, 1.0]}, maneuver=wrong(object())),
            "is no maneuver",
        ),
        (lambda: fid.campaign("rigid", -1), "runs: -1 is no count"),
        (lambda: fid.campaign("rigid", 2, jobs=-2), "jobs: -2 is no count"),
        (lambda: fid.campaign("rigid", 2, resume=wrong("no")), "resume: 'no' is neither True"),
        (lambda: fid.campaign("rigid", 2, time_limit=wrong("x")), "time_limit: 'x' is no number"),
        (lambda: fid.structure({}, "v.toml", degree=wrong("two")), "degree: 'two' is no count"),
        (lambda: fid.design("rigid", "bomber_rigid", size=wrong(3)), "size: 3 is no table"),
        (lambda: fid.design("rigid", "bomber_rigid", noise=wrong("x")), "noise: 'x' is no table"),
        (lambda: fid.design("rigid", "bomber_rigid", band=wrong(3)), "band: 3 is no band"),
        (lambda: fid.read_record({"time": [0.0]}, units=wrong("deg")), "units: 'deg' is no table"),
        (lambda: fid.read_record({"time": [0.0]}, hold=wrong([1])), "there is no hold"),
        (lambda: fid.run("rigid", progress=wrong("yes")), "progress: 'yes' is no function"),
        (lambda: fid.survey("flights.toml", figures=wrong(3)), "figures: 3 names no format"),
    ],
)
def test_values_of_a_wrong_type_are_refused_in_one_line(
    call: Callable[[], object], said: str
) -> None:
    with pytest.raises(fid.InputError) as raised:
        call()
    assert said in str(raised.value) and "\n" not in str(raised.value)
