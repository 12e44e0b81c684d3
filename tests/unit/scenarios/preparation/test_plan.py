"""Pairs of --from and --to, and what is refused."""

from __future__ import annotations

import pytest

from scenarios.preparation.plan import WHOLE, Plan, Segment, options_of, plan_of
from sim.errors import DeclarationError
from sim.record import Hold


def test_nothing_asked_is_the_whole_record_as_it_stands() -> None:
    assert plan_of() == plan_of([], []) == Plan() and Plan().segments == WHOLE


def test_one_end_may_be_open_and_several_come_in_pairs() -> None:
    assert plan_of([3.0]).segments == (Segment(3.0, None),)
    assert plan_of(None, [3.0]).segments == (Segment(None, 3.0),)
    assert plan_of([40.0, 10.0], [55.0, 25.0]).segments == (
        Segment(40.0, 55.0),
        Segment(10.0, 25.0),
    )
    assert plan_of(hold="linear", rate=20.0, lowpass=3.0) == Plan(WHOLE, Hold.LINEAR, 20.0, 3.0)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (dict(starts=[1.0, 5.0], stops=[2.0]), ("2 times --from and 1 times --to", "in pairs")),
        (dict(starts=[1.0, 5.0], stops=[2.0, 5.0]), ("--from 5 is not before --to 5",)),
        (dict(starts=[5.0, 1.0], stops=[9.0, 6.0]), ("1 to 6 s and 5 to 9 s overlap",)),
        (dict(starts=[1.0, float("nan")], stops=[2.0, 3.0]), ("--from nan is not before",)),
        (dict(hold="zero"), ("there is no hold 'zero'", "previous or linear")),
        (dict(rate=0.0), ("--rate", "0 Hz is no frequency")),
        (dict(rate="x"), ("--rate: 'x' is no frequency", "give a number in Hz")),
        (dict(lowpass=[2.0]), ("--lowpass: [2.0] is no frequency",)),
        (dict(lowpass=float("inf")), ("--lowpass", "inf Hz is no frequency")),
    ],
)
def test_what_is_no_plan_is_told_in_one_line(
    words: dict[str, object], parts: tuple[str, ...]
) -> None:
    with pytest.raises(DeclarationError) as told:
        plan_of(**words)  # type: ignore[arg-type]
    assert all(part in str(told.value) for part in parts) and "\n" not in str(told.value)


@pytest.mark.parametrize(
    "plan",
    [
        plan_of(),
        plan_of(stops=[25.0]),
        plan_of(
            [0.5, 30.0],
            [12.25, 41.125],
            "linear",
            25.0,
            8.0,
            trusted=True,
            columns="time,elevator,q",
        ),
    ],
)
def test_the_words_of_a_plan_make_the_same_plan(plan: Plan) -> None:
    words = options_of(plan)
    options = [word for word in words if word.startswith("--") and word != "--trust-record"]
    given = {
        option: [words[k + 1] for k, word in enumerate(words) if word == option]
        for option in options
    }
    again = plan_of(
        [float(value) for value in given.get("--from", [])],
        [float(value) for value in given.get("--to", [])],
        next(iter(given.get("--hold", [])), None),
        *(
            float(given[option][0]) if option in given else None
            for option in ("--rate", "--lowpass")
        ),
        trusted="--trust-record" in words,
        columns=next(iter(given.get("--columns", [])), None),
    )
    assert again == plan
