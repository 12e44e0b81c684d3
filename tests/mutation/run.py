"""Change one line of the program at a time and see whether its tests notice.

``python -m tests.mutation.run`` works through `tests.mutation.table`; a word after it keeps the
mutants whose file or text contains the word. Each is tried in a temporary copy of the checkout.

| result | meaning |
|---|---|
| killed | one of the named tests fails, as it should |
| killed by neighbours | the named tests pass, and one in the file's folder of unit tests fails |
| survived | all of these tests pass: a test is missing |
| broken | the text is not found once in its file, or the tests could not run |
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

ROOT = Path(__file__).parents[2]
LEFT_OUT = (".git", "__pycache__", ".*_cache", ".hypothesis", "*.egg-info", ".venv")
LONGEST = 900.0  # s for the tests of one mutant: an endless loop counts as noticed
PASSED, FAILED = 0, 1  # exit codes of pytest; any other says that the tests did not run


class Result(Enum):
    """What became of a mutant."""

    KILLED = "killed"
    KILLED_BY_NEIGHBOURS = "killed by neighbours"
    SURVIVED = "survived"
    BROKEN = "broken"


@dataclass(frozen=True)
class Mutant:
    """A change of one place in one file.

    Attributes
    ----------
    file : path below the root of the checkout.
    old, new : text that occurs once in the file, and what takes its place. Text and not a line
        number, so that edits elsewhere in the file do not matter.
    tests : what should notice, as pytest names it.
    """

    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def __str__(self) -> str:
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.file}: {old} -> {new or 'nothing'}"


def mutated(text: str, mutant: Mutant) -> str:
    """The text of a file with the change in it.

    Raises
    ------
    ValueError : the old text does not occur exactly once.
    """
    found = text.count(mutant.old)
    if found != 1:
        what = f"{mutant.file}: {mutant.old!r} occurs {found} times"
        raise ValueError(f"{what}; name a text that occurs once, or the file where it is now")
    return text.replace(mutant.old, mutant.new)


def unit_folder(file: str, root: Path = ROOT) -> str | None:
    """The folder of unit tests nearest to a file, None where there is none."""
    for folder in Path(file).parents:
        if folder.parts and (root / "tests" / "unit" / folder).is_dir():
            return (Path("tests/unit") / folder).as_posix()
    return None


def outcome_of(copy: Path, tests: Sequence[str]) -> tuple[int, str]:
    """Run tests in a copy until one fails: the exit code of pytest and the name of that test."""
    options = ("-n", "0", "-x", "-q", "-p", "no:cacheprovider")
    command = [sys.executable, "-m", "pytest", *options, *tests]
    single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment = {**os.environ, "PYTHONPATH": str(copy), **single}
    try:
        done = subprocess.run(
            command,
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            timeout=LONGEST,
        )
    except subprocess.TimeoutExpired:
        return FAILED, "no end within the time"
    marked = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return done.returncode, marked[1] if marked else ""


@contextmanager
def applied(copy: Path, mutant: Mutant) -> Iterator[None]:
    """The change in the copy, taken back at the end.

    Raises
    ------
    ValueError : the old text does not occur exactly once.
    """
    path = copy / mutant.file
    original = path.read_text(encoding="utf-8")
    try:
        _write(path, mutated(original, mutant))
        yield
    finally:
        _write(path, original)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    # Python trusts compiled code of the same second and size.
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()


def try_mutant(copy: Path, mutant: Mutant) -> tuple[Result, str]:
    """Result of one mutant in a copy whose tests pass without it, and the test that noticed."""
    try:
        with applied(copy, mutant):
            code, by = outcome_of(copy, mutant.tests)
            if code != PASSED:
                return (Result.KILLED if code == FAILED else Result.BROKEN), by
            folder = unit_folder(mutant.file, copy)
            code, by = outcome_of(copy, [folder]) if folder is not None else (PASSED, "")
            return (Result.KILLED_BY_NEIGHBOURS, by) if code == FAILED else (Result.SURVIVED, "")
    except (OSError, ValueError) as error:
        return Result.BROKEN, str(error)


def run(mutants: Sequence[Mutant], root: Path = ROOT) -> Iterator[tuple[Mutant, Result, str]]:
    """Try mutants one after the other in a temporary copy of ``root``.

    Raises
    ------
    RuntimeError : the named tests do not pass without a mutant.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        shutil.copytree(root, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
        named = sorted({test for mutant in mutants for test in mutant.tests})
        code, by = outcome_of(copy, named) if named else (PASSED, "")
        if code != PASSED:
            what = f"the named tests do not pass without a mutant ({by})"
            raise RuntimeError(f"{what}: mend them first")
        for mutant in mutants:
            yield mutant, *try_mutant(copy, mutant)


def main(words: Sequence[str] | None = None) -> int:
    """Print a line for each mutant; 1 where one survived or is broken, 2 where none was tried."""
    from tests.mutation.table import MUTANTS

    parser = argparse.ArgumentParser(description="Try the mutants of the table.")
    parser.add_argument("word", nargs="?", default="", help="part of a file's name or of a text")
    word, failures = parser.parse_args(words).word, 0
    try:
        for mutant, result, by in run([mutant for mutant in MUTANTS if word in str(mutant)]):
            failures += result is not Result.KILLED
            print(f"{result.value:<20} {mutant}{f'  [{by}]' if by else ''}", flush=True)
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 2
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
