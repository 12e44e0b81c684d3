"""Common elements of labs: pictures, command lines, tables, and questions with immediate checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import marimo as mo
from matplotlib.figure import Figure

from scenarios.plots.drawing import figure_document, figure_frame


@dataclass(frozen=True)
class Question:
    """A question of a lab.

    Attributes
    ----------
    text : the question, as Markdown.
    field : notebook element for the answer.
    right : function that returns whether an answer is right.
    hint : text shown after a wrong answer.
    reason : text shown after a right answer.
    """

    text: str
    field: Any
    right: Callable[[Any], bool]
    hint: str
    reason: str


def heading(number: int, title: str, aim: str) -> Any:
    """Return title and aim of a lab."""
    return mo.md(f"# Lab {number}. {title}\n\n**Aim.** {aim}")


def plotted(figure: Figure, description: str) -> Any:
    """Return a figure that zooms and shows values under the pointer, with its description."""
    return mo.Html(figure_frame(figure_document(figure, description), description, height=400))


def beside(controls: Sequence[Any], figure: Any) -> Any:
    """Return controls with their figure at the right, or below them on a narrow page."""
    column = mo.vstack([*controls], gap=1.0)
    return mo.Html(
        '<div style="display: flex; flex-wrap: wrap; gap: 1rem 1.5rem; align-items: flex-start">'
        f'<div style="flex: 1 1 15rem; min-width: 0">{mo.as_html(column).text}</div>'
        f'<div style="flex: 4 1 30rem; min-width: 0">{mo.as_html(figure).text}</div></div>'
    )


def sketch() -> Any:
    """Return the aircraft from the side and from above, with axes, angles, rates and signs."""
    description = "Aircraft from the side and from above with body axes, angles, rates and signs"
    # Given as a path: marimo would label the bytes of this SVG as PNG, and browsers would then not
    # draw it.
    source = Path(__file__).with_name("axes.svg")
    return mo.image(source, alt=description, style={"width": "100%", "max-width": "720px"})


def computing(what: str = "Computing the flight and its estimates") -> Any:
    """Return a message that is shown while the next block computes."""
    return mo.status.spinner(title=f"{what} ...", remove_on_exit=True)


def plain(text: str) -> str:
    """Return a text escaped for Markdown, so that ``:q`` is not read as an emoji and ``*`` and
    ``_`` not as emphasis.
    """
    return text.replace(":", "&#58;").replace("*", "\\*").replace("_", "\\_")


def tests_of(tests: Sequence[Any]) -> str:
    """Return channel, name and result of each test of a residual, as Markdown."""
    names = {"ljung-box": "Ljung-Box", "nis": "NIS"}
    return "; ".join(
        f"{test.channel or 'all'} ({names.get(test.name, test.name)}): "
        f"{'passed' if test.passed else '**failed**'}"
        for test in tests
    )


def command_line(line: str, what: str = "The same on the command line") -> Any:
    """Return a command that a student may copy, below the words ``what``."""
    note = "`methods=[]` leaves out the further methods of the scenario."
    return mo.md(f"{what}:\n\n```sh\n{line}\n```\n\n{note if 'methods=[]' in line else ''}")


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Any:
    """Return a table of texts; the caller has rounded the numbers."""
    lines = [
        " | ".join(headings),
        " | ".join([":--", *["--:"] * (len(headings) - 1)]),
        *(" | ".join(row) for row in rows),
    ]
    return mo.md("\n".join(f"| {line} |" for line in lines))


def sliders(controls: Any) -> Any:
    """Return controls below each other, each label above its slider."""
    return mo.vstack(list(controls.elements.values()), gap=1.0)


def number_field(unit: str) -> Any:
    """Return a field for a number; it is empty at first."""
    return mo.ui.number(value=None, step=None, label=f"answer, {unit}:", debounce=True)


def slider(start: float, stop: float, step: float, value: float, label: str) -> Any:
    """Return a slider that shows its value and computes when it is released."""
    return mo.ui.slider(
        start, stop, step=step, value=value, label=label, show_value=True, debounce=True
    )


def choice(options: Sequence[str]) -> Any:
    """Return a field for one of several answers; none is chosen at first."""
    return mo.ui.radio(options=options, value=None)


def fields(questions: Mapping[str, Question]) -> Any:
    """Return the answer fields of a lab, combined into one notebook element."""
    return mo.ui.dictionary({key: question.field for key, question in questions.items()})


def question_list(questions: Mapping[str, Question], answers: Any) -> Any:
    """Return the questions with their fields, and the feedback to each answer that was given."""
    blocks = []
    for number, (key, question) in enumerate(questions.items(), start=1):
        blocks.append(mo.md(f"**{number}.** {question.text}"))
        blocks.append(answers.elements[key])
        blocks.append(_feedback(question, answers.value[key]))
    right_count = sum(
        _is_right(question, answers.value[key]) for key, question in questions.items()
    )
    total = mo.md(f"*{right_count} of {len(questions)} answers are right.*")
    return mo.vstack([*blocks, total], gap=0.75)


def _is_right(question: Question, value: Any) -> bool:
    return value not in (None, "") and bool(question.right(value))


def _feedback(question: Question, value: Any) -> Any:
    if value in (None, ""):
        return mo.md("")
    if _is_right(question, value):
        return mo.callout(mo.md(f"Yes. {question.reason}"), kind="success")
    return mo.callout(mo.md(f"Not yet. {question.hint}"), kind="warn")
