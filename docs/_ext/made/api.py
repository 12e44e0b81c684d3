"""Pages of the API: one for each package, with its README first and then every module with its docstrings."""  # noqa: E501

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

# The packages at the top, in the order in which a reader meets them.
ROOTS = ("flightid", "scenarios", "ident", "sim")
PUBLIC = "flightid"  # its names have pages of their own, made/python

NOTEBOOK = re.compile(r"lab\d+_")


def packages(root: Path) -> Iterator[Path]:
    """Folders with Python modules below the roots, parents before children."""
    for name in ROOTS:
        top = root / name
        if (top / "__init__.py").is_file():
            yield top
            yield from sorted(
                path.parent for path in top.rglob("__init__.py") if path.parent != top
            )


def page_of(folder: Path, root: Path) -> str:
    """Name of a package's page below ``made``."""
    return f"api/{folder.relative_to(root).as_posix().replace('/', '.')}"


def modules_of(folder: Path) -> list[Path]:
    """Its modules, but those that begin with an underscore (``__main__`` is a command) and notebooks, which are no interface."""  # noqa: E501
    return sorted(
        path
        for path in folder.glob("*.py")
        if not path.name.startswith("_") and not NOTEBOOK.match(path.name)
    )


def overview(root: Path) -> str:
    """The page that the others stand under."""
    lines = [
        "# API\n",
        "One page for each package: what lives there and what it may import, then every module with its docstrings. "  # noqa: E501
        "The imports run one way: `flightid` and `scenarios` know `ident`, `ident` knows `sim`, nothing points back.\n",  # noqa: E501
    ]
    for folder in packages(root):
        if folder.parent == root:
            lines.append(
                f"- [`{folder.name}`]({page_of(folder, root)[4:]}.md): {summary(folder / '__init__.py')}"  # noqa: E501
            )
    return "\n".join(lines) + "\n"


def summary(module: Path) -> str:
    """First line of a module's docstring."""
    return (ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or "").split("\n")[0]


def package_page(folder: Path, readme: str, root: Path) -> str:
    """Markdown of one package.

    Parameters
    ----------
    folder : of the package. readme : its README with links turned, empty where there is none. root : of the checkout.
    """  # noqa: E501
    name = folder.relative_to(root).as_posix().replace("/", ".")
    _, _, body = readme.partition("\n") if readme.startswith("# ") else ("", "", readme)
    title = readme.splitlines()[0].removeprefix("# ") if readme.startswith("# ") else name
    parts = [f"# {name}\n", f"*{title}*\n" if title != name else "", body]
    modules = modules_of(folder)
    # A name that the package takes from a module of the same name is told there.
    parts.append(
        automodule(name, [path.stem for path in modules])
        if has_interface(folder / "__init__.py") and name != PUBLIC
        else described(name)
    )
    parts += [f"## {path.name}\n\n{automodule(f'{name}.{path.stem}')}" for path in modules]
    parts.append(children(folder, root))
    return "\n".join(part for part in parts if part)


def has_interface(init: Path) -> bool:
    """Whether a package exports or documents anything by itself."""
    text = init.read_text(encoding="utf-8").strip()
    return bool(text) and ("__all__" in text or "def " in text or "class " in text)


def automodule(name: str, but: Sequence[str] = ()) -> str:
    """All public members that have a docstring, some left out."""
    out = f"   :exclude-members: {', '.join(but)}\n" if but else ""
    return f"```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n{out}```\n"


def described(name: str) -> str:
    """The docstring of a package that exports nothing."""
    return f"```{{eval-rst}}\n.. automodule:: {name}\n```\n"


def children(folder: Path, root: Path) -> str:
    """Contents of the packages right below."""
    below: Sequence[Path] = sorted(path.parent for path in folder.glob("*/__init__.py"))
    if not below:
        return ""
    names = "\n".join(page_of(path, root)[4:] for path in below)
    return f"```{{toctree}}\n:hidden:\n\n{names}\n```\n"
