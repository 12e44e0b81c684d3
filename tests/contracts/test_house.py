"""Layout of the packages: lengths of files and functions, no package of one module, no double class
names, no import circles.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
INSTALLED = ("sim", "ident", "scenarios", "flightid")
ROOMS = (*INSTALLED, "exam")
LONGEST_FILE, MOST_LINES = 600, 80  # lines of a file and of a function
LEAST_OF_ONE = 150  # lines of a module that only one sibling imports
IMPORTS = 0.07  # largest share of import statements in all lines; the aim is 0.05
# Functions that may be longer; one that has become short must leave this list.
LONG: dict[str, str] = {}
# Files that may be longer; one that has become short must leave this list.
LONG_FILES: frozenset[str] = frozenset()
# Packages whose further content is data.
OF_DATA = {"scenarios/catalog"}
# Class names that still occur twice in a room; the list shrinks, and nothing is added to it.
TWICE: dict[str, frozenset[str]] = {
    "ident": frozenset(),
    "scenarios": frozenset({"Table"}),
}
# Folders in which one topic has one file by rule: effects, formats of files.
ONE_A_FILE = ("sim/effects/", "scenarios/files/formats/")
# Modules that one sibling imports and that are still shorter; the list shrinks, and nothing is
# added to it.
SHORT_OF_ONE: frozenset[str] = frozenset(
    {
        "flightid/plot.py",
    }
)

Graph = Mapping[str, frozenset[str]]


@cache
def modules() -> dict[str, ast.Module]:
    """Every Python file of the rooms by its path below the root, parsed."""
    paths = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in paths
    }


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
    """Files that a file imports anywhere: at the top, late in a function, or for type checking
    only.
    """
    names = []
    for node in statements(tree):
        if isinstance(node, ast.Import):
            names += [item.name for item in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = ".".join(path.split("/")[: -node.level]) if node.level else ""
            base = ".".join(part for part in (package, node.module) if part)
            names += [
                f"{base}.{item.name}" if file_of(f"{base}.{item.name}", files) else base
                for item in node.names
            ]
    return frozenset(found for name in names if (found := file_of(name, files)) and found != path)


def circles(graph: Graph) -> list[list[str]]:
    """Groups of files each of which leads to all others (Tarjan's strongly connected components of
    more than one file).
    """
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


def empty_headings(text: str) -> list[str]:
    """Headings (``# ---- ...``) of a module that have nothing below them."""
    lines = [line for line in text.splitlines() if line.strip()]
    below = [*lines[1:], "# ----"]
    return [a for a, b in zip(lines, below, strict=True) if a[:6] == b[:6] == "# ----"]


def test_headings_have_something_below_them() -> None:
    """Files that were merged kept the headings of what had moved on."""
    assert empty_headings("# ---- One\n\n\n# ---- Two\n\nx = 1\n\n# ---- Three\n") == [
        "# ---- One",
        "# ---- Three",
    ]
    found = {
        path: left
        for path in modules()
        if (left := empty_headings((ROOT / path).read_text(encoding="utf-8")))
    }
    assert found == {}


@pytest.mark.long
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
    return Counter(
        path.rpartition("/")[0] for path in modules() if not path.endswith("/__init__.py")
    )


def test_no_file_is_too_long() -> None:
    lengths = {
        path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in modules()
    }
    assert {
        path: length
        for path, length in lengths.items()
        if length > LONGEST_FILE and path not in LONG_FILES
    } == {}
    assert sorted(path for path in LONG_FILES if lengths.get(path, 0) <= LONGEST_FILE) == [], (
        "short or gone: strike them from LONG_FILES"
    )


def test_no_package_has_a_single_module() -> None:
    parents = {folder.rpartition("/")[0] for folder in folders()}
    single = {folder for folder, count in folders().items() if count == 1 and folder not in parents}
    assert single - OF_DATA == set(), "make it a module of the package above"


def test_class_names_are_used_once_in_a_room() -> None:
    for room in INSTALLED:
        trees = [tree for path, tree in modules().items() if path.startswith(f"{room}/")]
        names = Counter(
            node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)
        )
        twice = {name for name, count in names.items() if count > 1}
        assert twice == TWICE.get(room, frozenset()), f"class names of {room}"


def test_a_module_that_one_sibling_imports_is_long_enough() -> None:
    importers: dict[str, set[str]] = {}
    installed = {path: tree for path, tree in modules().items() if not path.startswith("exam/")}
    for path, targets in import_graph(installed).items():
        for target in targets:
            importers.setdefault(target, set()).add(path)
    found = {
        path
        for path, users in importers.items()
        if len(users) == 1
        and path.rpartition("/")[0] == min(users).rpartition("/")[0]
        and not path.endswith("__init__.py")
        and not path.startswith(ONE_A_FILE)
        and (ROOT / path).read_text(encoding="utf-8").count("\n") < LEAST_OF_ONE
    }
    assert found - SHORT_OF_ONE == set(), "it belongs into the module that imports it"
    assert SHORT_OF_ONE - found == set(), "long or gone: strike them from SHORT_OF_ONE"


@pytest.mark.long
def test_imports_are_a_small_share_of_all_lines() -> None:
    installed = {path: tree for path, tree in modules().items() if not path.startswith("exam/")}
    lines = sum((ROOT / path).read_text(encoding="utf-8").count("\n") for path in installed)
    nodes = [
        node
        for tree in installed.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    assert sum((node.end_lineno or 0) - node.lineno + 1 for node in nodes) <= IMPORTS * lines


def length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function below its first, without its docstring."""
    lines = (node.end_lineno or 0) - node.lineno
    if ast.get_docstring(node) is not None:
        lines -= (node.body[0].end_lineno or 0) - node.body[0].lineno + 1
    return lines


def long_functions(files: Mapping[str, ast.Module]) -> dict[str, int]:
    return {
        f"{path}::{node.name}": length(node)
        for path, tree in files.items()
        for node in statements(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and length(node) > MOST_LINES
    }


def test_functions_are_short() -> None:
    found = long_functions(modules())
    assert {name: lines for name, lines in found.items() if name not in LONG} == {}, "split them"
    assert [name for name in LONG if name not in found] == [], (
        "short or gone: strike them from LONG"
    )


def test_a_long_function_is_seen() -> None:
    def body(lines: int) -> ast.Module:
        return ast.parse("class C:\n    def f(self):\n" + "        x = 1\n" * lines)

    assert long_functions({"a.py": body(MOST_LINES)}) == {}
    assert long_functions({"a.py": body(MOST_LINES + 1)}) == {"a.py::f": MOST_LINES + 1}
    told = ast.parse('def f():\n    """One\n    two."""\n' + "    x = 1\n" * MOST_LINES)
    assert long_functions({"a.py": told}) == {}


DOCUMENTS = sorted(
    path
    for path in {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "labs").rglob("*.md")}
    | {path for room in (*ROOMS, "tests", "benchmarks") for path in (ROOT / room).rglob("*.md")}
    if not path.is_relative_to(ROOT / "docs" / "made")  # written when the site is built
)
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"`([^`\n]+)`|\]\(([^)#\s]+)")
# flightid/record/1 is a schema
A_PATH = re.compile(
    r"(?:sim|ident|scenarios|flightid(?!/[\w-]+/\d)|exam|tests|docs|labs|benchmarks)/[\w./*-]*"
)
A_FILE = re.compile(r"[\w/]+\.py")
A_MODULE = re.compile(r"(?:sim|ident|scenarios|flightid|exam|tests)(?:\.\w+)+")


def mentioned(text: str) -> Iterator[str]:
    """Paths of the project, Python files and dotted names of modules, in backticks or as targets of
    links, outside fenced blocks.
    """
    for inline, target in QUOTED.findall(FENCED.sub("", text)):
        if any(form.fullmatch(inline or target) for form in (A_PATH, A_FILE, A_MODULE)):
            yield inline or target


def exists(mention: str) -> bool:
    """Whether a path is there (stars match anything), or a dotted name is a module or a name in
    one.
    """
    if A_PATH.fullmatch(mention):
        return any(ROOT.glob(mention.rstrip("/")))
    if A_FILE.fullmatch(mention):
        return any(path.endswith(f"/{mention}") for path in modules()) or any(
            (ROOT / "docs").rglob(mention)
        )
    parts = mention.split(".")
    for kept in (len(parts), len(parts) - 1, len(parts) - 2):
        stem = ROOT.joinpath(*parts[:kept])
        file = stem.with_suffix(".py")
        if kept > 1 and file.is_file():
            return (
                kept == len(parts)
                or re.search(rf"\b{parts[kept]}\b", file.read_text(encoding="utf-8")) is not None
            )
    return ROOT.joinpath(*parts).is_dir()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_paths_in_a_document_exist(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    # A changelog tells what was; its paths are those of then.
    assert (
        path.name == "CHANGELOG.md"
        or [mention for mention in mentioned(text) if not exists(mention)] == []
    )


def test_a_wrong_path_is_seen() -> None:
    text = (
        "`sim/nowhere.py`, [there](docs/tracing.md), `sim.truth.flight.fly`, "
        "`sim.truth.flight.swim`, `scenarios/*/rigid.toml`, `sim/*.toml`\n"
    )
    text += (
        "`loop.py`, `tracing/loop.py`, `screening/loop.py`, `sim.truth.flight`, `sim.gone.flight`, "
        "`ident`, `a.py -x`\n"
    )
    found = [*mentioned(text + "```\n`ident/gone.py`\n```\n")]
    assert [mention for mention in found if not exists(mention)] == [
        "sim/nowhere.py",
        "sim.truth.flight.swim",
        "sim/*.toml",
        "screening/loop.py",
        "sim.gone.flight",
    ]
    assert len(found) == 11
