"""The Python of the documents under mypy: names, arguments and attributes that a page shows exist
with the types that it uses. ``test_docs.py`` runs the same blocks; here also the lines count that
a run does not reach.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.documents.snippets import DOCUMENTS, ROOT, blocks, name_of

pytestmark = pytest.mark.long  # mypy reads the whole package: most of a minute without its cache

FILE = "# file: "  # first line of a block that is a file of the reader's
WRONG = """\
import flightid as fid

found = fid.identify("flight.csv", "rigid", 3.0)
found.plots.fit()
"""


def modules() -> dict[str, str]:
    """Sources by the name of the page: the blocks of a page together, each file by itself."""
    out: dict[str, str] = {}
    for path in DOCUMENTS:
        stem = name_of(path).removesuffix(".md").replace("/", "__").replace("-", "_")
        written = [text for kind, text in blocks(path) if kind == "python"]
        together = [text for text in written if not text.startswith(FILE)]
        if together:
            out[stem] = "\n".join(together)
        files = [text for text in written if text.startswith(FILE)]
        out |= {f"{stem}__file_{number}": text for number, text in enumerate(files, start=1)}
    return out


def faults(sources: dict[str, str], folder: Path) -> list[str]:
    """Lines that mypy prints about ``sources``, written as modules into ``folder``."""
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    asked = [str(folder / f"{name}.py") for name in sources]
    done = subprocess.run(
        # dask_jobqueue, which one page shows, is on clusters only
        [
            *(sys.executable, "-m", "mypy", "--no-error-summary"),
            *("--disable-error-code", "import-not-found", *asked),
        ],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    return done.stdout.splitlines()


def test_python_of_the_documents_has_right_types(tmp_path: Path) -> None:
    sources = modules()
    assert {"README", "docs__start", "docs__how_to__python"} <= sources.keys()
    # A block with two mistakes stands beside: without it, a mypy that reads nothing would pass.
    found = faults(sources | {"wrong": WRONG}, tmp_path)
    ours = [line for line in found if Path(line.partition(":")[0]).name != "wrong.py"]
    assert not ours, "\n".join(ours)
    assert [line.rpartition("[")[2] for line in found] == ["arg-type]", "attr-defined]"]
