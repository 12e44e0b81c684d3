"""`--quiet` and `--json`: what of a command reaches the terminal."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from scenarios.plots.formats import Formats


@dataclass(frozen=True)
class Told:
    """Where a command writes its study (None: nowhere), in which formats its figures, and whether it may show how far it is."""

    out: Path | None
    figures: Formats
    progress: bool


@contextlib.contextmanager
def telling(out: Path | None, figures: Formats, *, quiet: bool, as_json: bool, documents: Sequence[str] = ()) -> Iterator[Told]:
    """Run a command that prints on stdout and writes ``documents``, by their paths in its folder, the study's JSON.

    With ``as_json`` nothing of it is printed but its document, several of them as a list; with ``quiet`` nothing but the warnings that its
    document holds, on stderr. Without a folder it writes into one that is gone afterwards.
    """
    if not (quiet or as_json):
        yield Told(out, figures, progress=True)
        return
    with contextlib.ExitStack() as stack:
        folder = out if out is not None else Path(stack.enter_context(TemporaryDirectory(prefix="flightid-"))) / "study"
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                yield Told(folder, figures if out is not None else (), progress=not quiet)
        except KeyboardInterrupt:
            if out is not None:
                raise
            raise KeyboardInterrupt from None  # what it says is kept is in a folder that is gone now
        texts = [(folder / name).read_text(encoding="utf-8") for name in documents]
    if as_json:
        if isinstance(sys.stdout, io.TextIOWrapper):
            # JSON is UTF-8 wherever it goes; a pipe of Windows has another code page.
            sys.stdout.reconfigure(encoding="utf-8", errors="backslashreplace")
        sys.stdout.write(texts[0] if len(texts) == 1 else "[\n" + ",\n".join(text.rstrip("\n") for text in texts) + "\n]\n")
        sys.stdout.flush()
        return
    for text in texts:
        for warning in json.loads(text).get("warnings", ()):
            print(f"flightid: warning: {warning}", file=sys.stderr)
