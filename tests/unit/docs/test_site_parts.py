"""What the site's extension does to links, docstrings and declarations, and what its check finds;
`.ci/run` builds the site itself.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docs._ext import check
from docs._ext.docstrings import plain
from docs._ext.links import turned
from docs._ext.made.commands import commands_page
from docs._ext.made.effects import effects_page
from docs._ext.made.models import models_page, names_page
from docs._ext.made.pages import page_names
from docs._ext.made.vehicles import vehicles_page
from sim.effects.library import effect_names
from sim.vehicles.factory import FAMILIES
from sim.vehicles.library import read_parameter_set, vehicle_names

ROOT = Path(__file__).parents[3]
PAGES = {
    "docs/how-to/watch.md": "how-to/watch",
    "CHANGELOG.md": "made/changelog",
    "sim": "made/api/sim",
    "sim/record.py": "made/api/sim#recordpy",
}


@pytest.mark.parametrize(
    ("written", "on_the_site"),
    [
        ("[a](watch.md)", "[a](watch.md)"),
        ("[a](watch.md#what-arrives)", "[a](watch.md#what-arrives)"),
        ("[a](../../CHANGELOG.md)", "[a](../made/changelog.md)"),
        ("[`x`](../../sim/record.py)", "[`x`](../made/api/sim.md#recordpy)"),
        ("[a](../../sim/)", "[a](../made/api/sim.md)"),
        ("[a](../../LICENSE)", "a"),
        ("[a](https://example.org) and [b](#here)", "[a](https://example.org) and [b](#here)"),
        ("![a](../phase.png)", "![a](../phase.png)"),
        ("```text\n[a](../../LICENSE)\n```\n", "```text\n[a](../../LICENSE)\n```\n"),
    ],
)
def test_links_of_the_checkout_become_links_of_the_site(written: str, on_the_site: str) -> None:
    assert (
        turned(
            written,
            "docs/how-to/own-record.md",
            "how-to/own-record",
            PAGES,
            frozenset({"docs/phase.png"}),
        )
        == on_the_site
    )


def test_every_document_and_package_is_a_page() -> None:
    names = page_names(ROOT)
    assert {
        f"docs/{page}.md"
        for page in ("start", "limits", "how-to/watch", "decisions/0001-three-rooms")
    } <= names.keys()
    assert (
        names["sim/effects/dynamics"]
        == names["sim/effects/dynamics/README.md"]
        == "made/api/sim.effects.dynamics"
    )
    assert names["ident/filters/ekf.py"] == "made/api/ident.filters#ekfpy"
    assert names["CONTRIBUTING.md"] == "made/contributing"


def test_a_docstring_reads_the_same() -> None:
    text = [
        "An update_ of *all* |x|, see ``fly`` and `run`.",
        "",
        "    x_dot = A x",
        "",
        "Parameters",
        "----------",
        "a_, b : shapes ``(n,)``,",
        "    in s.",
        "",
    ]
    assert "\n".join(plain(text)) == (
        "An update\\_ of \\*all\\* \\|x\\|, see \\ ``fly``\\  and \\ ``run``\\ .\n\n::\n\n        "
        "x_dot = A x\n\n"
        "**Parameters**\n\n* ``a_, b``: shapes \\ ``(n,)``\\ , in s.\n"
    )
    assert plain(["- one", "  of two lines", "- two"]) == ["* one of two lines", "* two", ""]
    assert plain(["1. begins like a list"]) == ["\\ 1. begins like a list", ""]


def test_made_pages_say_what_the_code_declares() -> None:
    effects = effects_page()
    assert all(
        f"\n### {name}\n" in effects for name in {name.partition(":")[0] for name in effect_names()}
    )
    assert all(f"`{name}`" in effects for name in effect_names())
    models, names = models_page(), names_page()
    for name, (equations, constants, derivatives) in FAMILIES.items():
        assert f"\n## {name}\n" in models
        for each in (
            *constants,
            *derivatives,
            *(signal.name for signal in (*equations.states, *equations.inputs, *equations.outputs)),
        ):
            assert f"| `{each}` |" in models and f"| `{each}` |" in names
    vehicles = vehicles_page()
    for name in vehicle_names():
        assert all(
            f"| `{number.name}` | {number.value:.7g} |" in vehicles
            for number in read_parameter_set(name).numbers
        )


def test_every_command_is_on_its_page_with_every_option() -> None:
    from typer.main import get_command

    from scenarios.cli import app

    page = commands_page()
    commands = {
        name: command
        for name, command in get_command(app).commands.items()  # type: ignore[attr-defined]
        if not command.hidden
    }
    for name, command in commands.items():
        part = page.split(f"\n## flightid {name}\n")[1].split("\n## ")[0]
        for item in command.params:
            if (
                not getattr(item, "hidden", False)
                and item.opts[0].startswith("-")
                and item.name != "help"
            ):
                assert f"`{item.opts[0]}" in part, (name, item.opts)


def test_the_check_of_a_site_finds_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "b.html").write_text('<h1 id="there">b</h1>')
    (tmp_path / "index.html").write_text(
        '<a href="b.html#there">1</a><a href="b.html#gone">2</a><a href="c.html">3</a><a '
        'href="https://example.org">4</a>'
        '<script src="https://example.org/x.js"></script><img src="x.png">'
    )
    (tmp_path / "x.css").write_text("@font-face { src: url('https://example.org/x.woff'); }")
    assert list(check.complaints(tmp_path)) == [
        "index.html fetches https://example.org/x.js",
        "index.html: b.html#gone: there is no such place in it",
        "index.html: c.html: there is no such file",
        "index.html: x.png: there is no such file",
        "x.css fetches from another host",
    ]


def test_an_index_finds_the_objects_that_sphinx_finds() -> None:
    """Oracle: the parent class, which looks through all objects."""
    domains = pytest.importorskip("sphinx.domains.python", reason="the site's extra is absent")
    from docs._ext.references import IndexedPythonDomain

    names = ("a.Model", "a.b.Model", "a.b.Model.fit", "c.fit", "Model", "c.d", "c.d.fit", "e.M")
    kinds = ("class", "class", "method", "function", "class", "module", "function", "data")
    found = []
    for domain in (domains.PythonDomain, IndexedPythonDomain):
        env: Any = SimpleNamespace(domaindata={})
        one = domain(env)
        for number, (name, kind) in enumerate(zip(names, kinds, strict=True)):
            one.data["objects"][name] = domains.ObjectEntry(f"page{number}", name, kind, False)
        found.append(
            [
                one.find_obj(env, module, parent, name, role, mode)
                for module in ("", "a", "a.b", "c", "c.d")
                for parent in ("", "Model")
                for name in ("Model", "fit", "fit()", "b.Model", "d.fit", "M", "ndarray", "")
                for role in (None, "class", "func", "obj", "meth", "mod")
                for mode in (0, 1)
            ]
        )
    assert found[0] == found[1] and sum(map(len, found[0])) > 50


def test_stems_of_the_search_index_are_those_of_sphinx() -> None:
    english = pytest.importorskip("sphinx.search.en", reason="the site's extra is absent")
    from docs._ext.faster import CachedEnglish

    words = ("derivatives", "Estimation", "running", "identify", "identifies", "alpha", "q", "")
    cached, plain = CachedEnglish({}), english.SearchEnglish({})
    assert [cached.stem(word) for word in words * 2] == [plain.stem(word) for word in words * 2]
    assert cached.stem("identify") == cached.stem("identifies") != "identifies"


def test_pages_are_spread_and_none_is_lost() -> None:
    pytest.importorskip("sphinx", reason="the site's extra is absent")
    from docs._ext.faster import PIECES, spread

    names = [f"page{number:03d}" for number in range(250)]
    dealt = list(names)
    spread(None, None, dealt)
    assert sorted(dealt) == names
    # neighbours, which take alike long, are in different pieces
    assert abs(dealt.index("page001") - dealt.index("page000")) >= len(names) // PIECES


def test_a_command_is_shown_by_the_names_of_its_arguments() -> None:
    pytest.importorskip("sphinx", reason="the site's extra is absent")
    from docs._ext.docstrings import signature

    def command(record: str, out: str = "x") -> None: ...

    shown = "(record: <typer.models.ArgumentInfo object at 0x1>, out='x')"
    assert signature(None, "function", "command", command, None, shown, "None") == (
        "(record, out)",
        "None",
    )
    assert signature(None, "function", "command", command, None, "(record)", "None") is None


def test_every_public_name_and_every_picture_is_shown() -> None:
    import flightid
    from docs._ext.made.gallery import PICTURES, gallery_page
    from docs._ext.made.python import python_pages
    from scenarios.studies.catalogue import scenario_names

    pages = dict(python_pages())
    public = {name for name in flightid.__all__ if not name.startswith("_")}
    assert {name.rpartition("/")[2] for name in pages} == public | {"python"}
    assert all(f"python/{name}.md" in pages["python"] for name in public)
    shown = gallery_page()
    pictures = sorted(PICTURES.glob("*.svg"))
    assert len(pictures) > 80 and all(f"gallery/{each.name}" in shown for each in pictures), (
        "docs/_ext/gallery_pictures.py makes them again"
    )
    assert all(f"scenario/{name}.md" in shown for name in scenario_names())
    families = {name.partition(":")[0] for name in effect_names()}
    assert {each.stem for each in pictures} >= {
        *(f"effect-{family}" for family in families),
        *(f"scenario-{name}" for name in scenario_names()),
    }, "docs/_ext/gallery_pictures.py makes them"
    assert sum(each.stat().st_size for each in pictures) < 1_000_000


def test_a_thumbnail_shows_lines_in_its_frame() -> None:
    from xml.etree import ElementTree

    from docs._ext.gallery_pictures import HEIGHT, WIDTH, thumbnail

    time = np.linspace(0.0, 1.0, 500)
    rows = [(np.array([time, time**2]), "#000000"), (np.array([0.0 * time]), "#111111")]
    lines = [
        each
        for each in ElementTree.fromstring(thumbnail(rows, words="x")).iter()
        if each.tag.endswith("polyline")
    ]
    assert [each.attrib["stroke"] for each in lines] == ["#888888", "#000000", "#111111"]
    for each in lines:
        points = np.array([pair.split(",") for pair in each.attrib["points"].split()], dtype=float)
        assert np.all((points >= 0.0) & (points <= (WIDTH, HEIGHT))) and len(points) <= 160


def test_the_sketch_of_axes_is_one_in_documents_and_labs() -> None:
    shown = (ROOT / "docs" / "axes.svg").read_bytes()
    assert shown == (ROOT / "flightid" / "labs" / "axes.svg").read_bytes()
    assert all(sign in shown.decode() for sign in ("nose up", "right wing down", "trailing edge"))


def test_the_page_of_a_lab_has_what_its_notebook_says() -> None:
    from docs._ext.made.labs import figures_of, lab_page, notebooks

    source = notebooks()[4]
    page = lab_page(4, source)
    assert page.startswith("# Lab 4. An augmented aircraft and its equivalent system")
    for part in (
        "$M_\\alpha > 0$",
        "![Axes, angles, rates and their signs](../../axes.svg)",
        "stick amplitude, in",
        "1. Airframe F without its control law",
        "## To think about",
    ):
        assert part in page, part
    assert page.index("## Theory") < page.index("## Try it") < page.index("## Questions")
    assert page.count("## Try it") == page.count("## Questions") == 1
    assert len(figures_of(source)) == 2


def test_each_lab_has_a_page_with_a_figure_and_all_its_questions() -> None:
    from docs._ext.made.labs import lab_pages, notebooks

    pages = dict(lab_pages())
    assert len(pages) == len(notebooks()) >= 9
    for number, source in notebooks().items():
        page = pages[f"labs/lab{number}"]
        assert f"gallery/lab-{number}-1.png" in page, "docs/_ext/page_pictures.py makes it"
        text = source.read_text(encoding="utf-8")
        if "page.Question(" in text:
            assert f"\n{text.count('page.Question(')}. " in page
        for line in page.splitlines():
            assert not line.startswith("## ") or page.count(f"{line}\n") == 1, (number, line)


def test_functions_have_the_figure_that_was_made_for_them() -> None:
    import flightid
    from docs._ext.made.python import PICTURES, python_pages

    pages = dict(python_pages())
    made = [path.stem.removeprefix("python-") for path in PICTURES.glob("python-*.png")]
    assert {"identify", "check", "diagnose", "frequency_response"} <= set(made)
    for name in made:
        assert name in flightid.__all__ and f"python-{name}.png" in pages[f"python/{name}"]
    assert "gallery" not in pages["python/vehicles"]


def test_entries_that_share_a_line_are_items_of_their_own() -> None:
    text = """First line.

Parameters
----------
model : the path of
its file. vehicle : a name: or numbers, ``a : b``. start, stop : s.

Examples
--------
>>> 1 + 1
2
"""
    told = plain(text.splitlines())
    items = [line for line in told if line.startswith("* ")]
    assert [item.partition(":")[0] for item in items] == [
        "* ``model``",
        "* ``vehicle``",
        "* ``start, stop``",
    ]
    assert items[0].endswith("the path of its file.") and "``a : b``" in items[1]
    assert told[told.index(">>> 1 + 1") + 1] == "2"
