"""The house keeps its order: lengths of files and functions, folders that say what they are for, no import circles."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("sim", "ident", "scenarios", "flightid", "exam")
LONGEST_FILE, MOST_LINES = 600, 80  # lines of a file and of a function
SMALL = 5  # files of a folder that needs no README
# Functions that may be longer; one that has become short must leave this list.
LONG = {
    "ident/banks/equation_kernels.py::along": "one pass over time, written out so that nothing is allocated in it",
}

Graph = Mapping[str, frozenset[str]]


@cache
def modules() -> dict[str, ast.Module]:
    """Every Python file of the rooms by its path below the root, parsed."""
    paths = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def statements(tree: ast.Module) -> Iterator[ast.AST]:
    """Every statement at any depth; expressions, of which there are many, are not looked into."""
    left: list[ast.AST] = [tree]
    while left:
        node = left.pop()
        yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            left += getattr(node, field, ())


def file_of(name: str, files: Mapping[str, ast.Module]) -> str | None:
    """The file of a dotted module name, None where it is no module of these."""
    stem = name.replace(".", "/")
    return next((path for path in (f"{stem}.py", f"{stem}/__init__.py") if path in files), None)


def imported(path: str, tree: ast.Module, files: Mapping[str, ast.Module]) -> frozenset[str]:
    """Files that a file imports anywhere: at the top, late in a function, or for type checking only."""
    names = []
    for node in statements(tree):
        if isinstance(node, ast.Import):
            names += [item.name for item in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = ".".join(path.split("/")[: -node.level]) if node.level else ""
            base = ".".join(part for part in (package, node.module) if part)
            names += [f"{base}.{item.name}" if file_of(f"{base}.{item.name}", files) else base for item in node.names]
    return frozenset(found for name in names if (found := file_of(name, files)) and found != path)


def circles(graph: Graph) -> list[list[str]]:
    """Groups of files each of which leads to all others (Tarjan's strongly connected components of more than one file)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for target in sorted(graph[node]):
            if target not in order:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], order[target])
        if low[node] == order[node]:
            at = stack.index(node)
            group = stack[at:]
            del stack[at:]
            if len(group) > 1:
                found.append(sorted(group))

    for start in sorted(graph):
        if start not in order:
            visit(start)
    return found


def import_graph(files: Mapping[str, ast.Module]) -> Graph:
    return {path: imported(path, tree, files) for path, tree in files.items()}


def test_no_file_leads_back_to_itself_by_imports() -> None:
    graph = import_graph(modules())
    assert sum(map(len, graph.values())) > len(graph), "hardly any import was found"
    assert circles(graph) == []


@pytest.mark.parametrize(
    "back",
    [
        "import a.one",
        "from a import one",
        "from a.one import thing",
        "def f():\n    from a.one import thing",
        "from .one import thing",
        "from . import one",
    ]
    + ["from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from a.one import thing"],
)
def test_a_circle_is_seen_however_it_is_closed(back: str) -> None:
    sources = {
        "a/__init__.py": "",
        "a/one.py": "from a.two import other",
        "a/two.py": "import a.three",
        "a/three.py": back,
        "a/four.py": "import a.one",
    }
    files = {name: ast.parse(text) for name, text in sources.items()}
    assert circles(import_graph(files)) == [["a/one.py", "a/three.py", "a/two.py"]]
    assert circles(import_graph({**files, "a/three.py": ast.parse("import b.one")})) == []


def folders() -> Counter[str]:
    """How many Python files besides ``__init__.py`` a folder has, folders without any left out."""
    return Counter(path.rpartition("/")[0] for path in modules() if not path.endswith("/__init__.py"))


def test_no_file_is_too_long() -> None:
    lengths = {path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in modules()}
    assert {path: length for path, length in lengths.items() if length > LONGEST_FILE} == {}


def test_every_larger_folder_says_what_it_is_for() -> None:
    assert [folder for folder, count in folders().items() if count > SMALL and not (ROOT / folder / "README.md").is_file()] == []


def long_functions(files: Mapping[str, ast.Module]) -> dict[str, int]:
    return {
        f"{path}::{node.name}": (node.end_lineno or 0) - node.lineno
        for path, tree in files.items()
        for node in statements(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (node.end_lineno or 0) - node.lineno > MOST_LINES
    }


def test_functions_are_short() -> None:
    found = long_functions(modules())
    assert {name: lines for name, lines in found.items() if name not in LONG} == {}, "split them"
    assert [name for name in LONG if name not in found] == [], "short or gone: strike them from LONG"


def test_a_long_function_is_seen() -> None:
    def body(lines: int) -> ast.Module:
        return ast.parse("class C:\n    def f(self):\n" + "        x = 1\n" * lines)

    assert long_functions({"a.py": body(MOST_LINES)}) == {}
    assert long_functions({"a.py": body(MOST_LINES + 1)}) == {"a.py::f": MOST_LINES + 1}


DOCUMENTS = sorted(
    path
    for path in {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "labs").rglob("*.md")}
    | {path for room in (*ROOMS, "tests", "benchmarks") for path in (ROOT / room).rglob("*.md")}
    if not path.is_relative_to(ROOT / "docs" / "made")  # written when the site is built
)
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"`([^`\n]+)`|\]\(([^)#\s]+)")
A_PATH = re.compile(r"(?:sim|ident|scenarios|flightid(?!/[\w-]+/\d)|exam|tests|docs|labs|benchmarks)/[\w./*-]*")  # flightid/record/1 is a schema
A_FILE = re.compile(r"[\w/]+\.py")
A_MODULE = re.compile(r"(?:sim|ident|scenarios|flightid|exam|tests)(?:\.\w+)+")


def mentioned(text: str) -> Iterator[str]:
    """Paths of the project, Python files and dotted names of modules, in backticks or as targets of links, outside fenced blocks."""
    for inline, target in QUOTED.findall(FENCED.sub("", text)):
        if any(form.fullmatch(inline or target) for form in (A_PATH, A_FILE, A_MODULE)):
            yield inline or target


def exists(mention: str) -> bool:
    """Whether a path is there (stars match anything), or a dotted name is a module or a name in one."""
    if A_PATH.fullmatch(mention):
        return any(ROOT.glob(mention.rstrip("/")))
    if A_FILE.fullmatch(mention):
        return any(path.endswith(f"/{mention}") for path in modules()) or any((ROOT / "docs").rglob(mention))
    parts = mention.split(".")
    for kept in (len(parts), len(parts) - 1, len(parts) - 2):
        stem = ROOT.joinpath(*parts[:kept])
        file = stem.with_suffix(".py")
        if kept > 1 and file.is_file():
            return kept == len(parts) or re.search(rf"\b{parts[kept]}\b", file.read_text(encoding="utf-8")) is not None
    return ROOT.joinpath(*parts).is_dir()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_paths_in_a_document_exist(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    # A changelog tells what was; its paths are those of then.
    assert path.name == "CHANGELOG.md" or [mention for mention in mentioned(text) if not exists(mention)] == []


def test_a_wrong_path_is_seen() -> None:
    text = "`sim/nowhere.py`, [there](docs/tracing.md), `sim.truth.flight.fly`, `sim.truth.flight.swim`, `scenarios/*/rigid.toml`, `sim/*.toml`\n"
    text += "`loop.py`, `tracing/loop.py`, `screening/loop.py`, `sim.truth.flight`, `sim.gone.flight`, `ident`, `a.py -x`\n"
    found = [*mentioned(text + "```\n`ident/gone.py`\n```\n")]
    assert [mention for mention in found if not exists(mention)] == [
        "sim/nowhere.py",
        "sim.truth.flight.swim",
        "sim/*.toml",
        "screening/loop.py",
        "sim.gone.flight",
    ]
    assert len(found) == 11
