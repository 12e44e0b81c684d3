"""Pages of the labs: what a notebook says, without running it; figures are in `docs/gallery`."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

PICTURES = Path(__file__).parents[2] / "gallery"
FOLDER = Path(__file__).parents[3] / "flightid" / "labs"
NAME = re.compile(r"lab(\d+)_\w+\.py")
CONTROLS = ("slider", "dropdown", "checkbox", "number", "radio")


def notebooks() -> dict[int, Path]:
    """Number and file of each lab."""
    found = {}
    for path in FOLDER.glob("lab*.py"):
        if name := NAME.fullmatch(path.name):
            found[int(name[1])] = path
    return dict(sorted(found.items()))


def lab_pages() -> Iterator[tuple[str, str]]:
    """Name below ``made`` and Markdown of each lab."""
    for number, path in notebooks().items():
        yield f"labs/lab{number}", lab_page(number, path)


def lab_page(number: int, path: Path) -> str:
    """Title, aim, theory, controls, figures as they first stand, and questions of a lab."""
    cells = [
        node
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
    ]
    head = ""
    parts: list[str] = []
    asked: list[str] = []
    labels: list[str] = []
    for cell in cells:
        for call in calls(cell):
            words = [text_of(each) for each in call.args]
            match name_of(call):
                case "heading":
                    head = f"# Lab {number}. {words[1]}\n\n**Aim.** {plain(words[2])}\n"
                case "aircraft_sketch":
                    parts.append("![Axes, angles, rates and their signs](../../axes.svg)\n")
                case "md" if words and re.match(r"\s*## .*\n", words[0].strip()):
                    parts.append(below(plain(words[0])))
                case "Question":
                    asked.append(plain(words[0]))
                case name if name in CONTROLS:
                    label = next((text_of(k.value) for k in call.keywords if k.arg == "label"), "")
                    labels += [text for text in (label or (words[-1:] and words[-1]),) if text]
    return "\n".join(
        [
            head,
            f"This page shows the lab as it begins. `flightid lab {number}` opens the notebook: "
            "there figures follow the controls, and questions check the answers "
            "([how to](README.md)).\n",
            *parts[: 1 + at_try(parts)],
            *controls(labels),
            *figures(number, figures_of(path)),
            *parts[1 + at_try(parts) :],
            *questions(asked),
        ]
    )


def figures_of(path: Path) -> list[str]:
    """What each figure of a notebook shows, in the order in which they stand; each once."""
    found = [
        text_of(call.args[1])
        for call in calls(ast.parse(path.read_text(encoding="utf-8")))
        if name_of(call) == "interactive_figure" and len(call.args) > 1
    ]
    return list(dict.fromkeys(found))


def calls(cell: ast.AST) -> Iterator[ast.Call]:
    """Calls of a cell in the order in which they stand."""
    found = [node for node in ast.walk(cell) if isinstance(node, ast.Call)]
    yield from sorted(found, key=lambda node: (node.lineno, node.col_offset))


def name_of(call: ast.Call) -> str:
    """Last name of what is called: ``slider`` of ``mo.ui.slider``."""
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def text_of(node: ast.expr) -> str:
    """A text that is a constant; empty of everything else."""
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def plain(text: str) -> str:
    """A text of several lines without its indentation."""
    first, _, rest = text.strip("\n").partition("\n")
    if first.startswith(" ") or not rest:
        return textwrap.dedent(text).strip()
    return f"{first}\n{textwrap.dedent(rest)}".strip()


def below(text: str) -> str:
    """A section; an equation between two dollar signs gets lines of its own."""
    return re.sub(r"\$\$\s*(.+?)\s*\$\$", r"$$\n\1\n$$", text, flags=re.DOTALL) + "\n"


def at_try(parts: list[str]) -> int:
    """Index of the theory, behind which controls and figures stand; the last part where there is
    none.
    """
    found = [at for at, part in enumerate(parts) if part.startswith("## Theory")]
    return found[0] if found else len(parts) - 1


def controls(labels: list[str]) -> Iterator[str]:
    """What may be changed in the notebook."""
    seen = list(dict.fromkeys(label.rstrip(":") for label in labels if "answer" not in label))
    if seen:
        yield f"## Try it\n\nThe notebook has controls for {'; '.join(seen)}.\n"


def figures(number: int, pictures: list[str]) -> Iterator[str]:
    """The figures that were drawn for the gallery, each with what it shows."""
    for at, told in enumerate(pictures, 1):
        if (PICTURES / f"lab-{number}-{at}.png").is_file():
            caption = told[:1].upper() + told[1:]
            yield f"![{caption}](../../gallery/lab-{number}-{at}.png)\n\n*{caption}.*\n"


def questions(asked: list[str]) -> Iterator[str]:
    """Questions that the notebook answers, numbered."""
    if asked:
        lines = [f"{number}. {' '.join(text.split())}" for number, text in enumerate(asked, 1)]
        yield "## Questions\n\n" + "\n".join(lines) + "\n"
