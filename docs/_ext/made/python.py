"""Pages of the Python interface: one for each name that ``import flightid`` gives."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

PICTURES = Path(__file__).parents[2] / "gallery"
KINDS = {"functions": "Functions", "results": "Results and inputs", "modules": "Modules"}


def public_names() -> dict[str, list[str]]:
    """Names of ``flightid.__all__`` by kind: functions, classes, modules."""
    import flightid

    out: dict[str, list[str]] = {kind: [] for kind in KINDS}
    for name in flightid.__all__:
        if name.startswith("_"):
            continue
        given = getattr(flightid, name)
        kind = (
            "modules"
            if inspect.ismodule(given)
            else "results"
            if inspect.isclass(given)
            else "functions"
        )
        out[kind].append(name)
    return out


def python_pages() -> Iterator[tuple[str, str]]:
    """Name below ``made`` and Markdown of the overview, and of a page for each name."""
    import flightid

    lines = [
        "# Python\n",
        "Everything that `import flightid` gives, a page each, with its arguments and an example. "
        "[Python](../how-to/python.md) shows how they work together.\n",
    ]
    listed = []
    for kind, names in public_names().items():
        lines += [f"## {KINDS[kind]}\n", "| name | what it is |", "|---|---|"]
        for name in names:
            told = (inspect.getdoc(getattr(flightid, name)) or "").partition("\n\n")[0]
            first = " ".join(told.split()).replace("|", "\\|").replace("``", "`")
            lines.append(f"| [`{name}`](python/{name}.md) | {first} |")
            listed.append(name)
            yield f"python/{name}", _page(name, kind)
        lines.append("")
    below = "\n".join(f"python/{name}" for name in listed)
    lines.append(f"```{{toctree}}\n:hidden:\n\n{below}\n```\n")
    yield "python", "\n".join(lines)


def _page(name: str, kind: str) -> str:
    directive = {"functions": "autofunction", "results": "autoclass", "modules": "automodule"}[kind]
    members = "" if kind == "functions" else "   :members:\n"
    members += "   :inherited-members: Mapping\n" if kind == "results" else ""
    # A module is indexed where its package is described.
    members += "   :no-index:\n" if kind == "modules" else ""
    text = f"# flightid.{name}\n\n```{{eval-rst}}\n.. {directive}:: flightid.{name}\n{members}```\n"
    if not (PICTURES / f"python-{name}.png").is_file():
        return text
    told = f"A figure of what `{name}` returns"
    return f"{text}\n![{told}](../../gallery/python-{name}.png)\n\n*{told}.*\n"
