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
    is_right : function that returns whether an answer is right.
    hint : text shown after a wrong answer.
    reason : text shown after a right answer.
    """

    text: str
    field: Any
    is_right: Callable[[Any], bool]
    hint: str
    reason: str


def heading(number: int, title: str, aim: str) -> Any:
    """Return title and aim of a lab."""
    return mo.md(f"# Lab {number}. {title}\n\n**Aim.** {aim}")


def interactive_figure(figure: Figure, description: str) -> Any:
    """Return a figure that zooms and shows values under the pointer, with its description."""
    return mo.Html(figure_frame(figure_document(figure, description), description, height=400))


def with_controls(controls: Sequence[Any], figure: Any) -> Any:
    """Return controls at the left of their figure, or above it on a narrow page."""
    column = mo.vstack([*controls], gap=1.0)
    return mo.Html(
        '<div style="display: flex; flex-wrap: wrap; gap: 1rem 1.5rem; align-items: flex-start">'
        f'<div style="flex: 1 1 15rem; min-width: 0">{mo.as_html(column).text}</div>'
        f'<div style="flex: 4 1 30rem; min-width: 0">{mo.as_html(figure).text}</div></div>'
    )


def aircraft_sketch() -> Any:
    """Return a picture of the aircraft from two sides, with axes, angles, rates and signs."""
    description = "Aircraft from the side and from above with body axes, angles, rates and signs"
    # The image is passed as a path, not as bytes: marimo labels the bytes of an SVG as PNG, which
    # browsers do not draw.
    source = Path(__file__).with_name("axes.svg")
    return mo.image(source, alt=description, style={"width": "100%", "max-width": "720px"})


def progress_message(task: str = "Computing the flight and its estimates") -> Any:
    """Return a context manager that shows a message while its block computes."""
    return mo.status.spinner(title=f"{task} ...", remove_on_exit=True)


def escaped(text: str) -> str:
    """Return a text with the special characters of Markdown escaped.

    Otherwise ``:q`` would be shown as an emoji, and ``*`` and ``_`` would mark emphasis.
    """
    return text.replace(":", "&#58;").replace("*", "\\*").replace("_", "\\_")


def residual_tests(tests: Sequence[Any]) -> str:
    """Return channel, name and result of each test of a residual, as Markdown."""
    names = {"ljung-box": "Ljung-Box", "nis": "NIS"}
    return "; ".join(
        f"{test.channel or 'all'} ({names.get(test.name, test.name)}): "
        f"{'passed' if test.passed else '**failed**'}"
        for test in tests
    )


def command_line(line: str, title: str = "The same on the command line") -> Any:
    """Return a command that a student may copy, below its title."""
    note = ""
    if "methods=[]" in line:
        note = "With `methods=[]`, only the main method of the scenario is applied."
    return mo.md(f"{title}:\n\n```sh\n{line}\n```\n\n{note}")


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Any:
    """Return a table. The cells are texts: the caller formats the numbers."""
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
    """Return a slider that shows its value. Cells that use it run when the slider is released."""
    return mo.ui.slider(
        start, stop, step=step, value=value, label=label, show_value=True, debounce=True
    )


def multiple_choice(options: Sequence[str]) -> Any:
    """Return a field for the choice of one answer from several; none is chosen at first."""
    return mo.ui.radio(options=options, value=None)


def answer_fields(questions: Mapping[str, Question]) -> Any:
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
    return value not in (None, "") and bool(question.is_right(value))


def _feedback(question: Question, value: Any) -> Any:
    if value in (None, ""):
        return mo.md("")
    if _is_right(question, value):
        return mo.callout(mo.md(f"Yes. {question.reason}"), kind="success")
    return mo.callout(mo.md(f"Not yet. {question.hint}"), kind="warn")
