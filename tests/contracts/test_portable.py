"""What another system has not, or does otherwise, is used where it is known: forks, signals, locks,
and the coding and line ends of files.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("sim", "ident", "scenarios", "flightid", "exam")

# Modules and attributes that Windows has not, and the files that ask first whether the system has
# them.
ABSENT_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog", "select"}
ABSENT = {
    **{
        "os": {
            "fork",
            "forkpty",
            "killpg",
            "setsid",
            "setpgid",
            "getuid",
            "geteuid",
            "mkfifo",
            "wait",
            "wait3",
            "wait4",
            "sched_getaffinity",
        }
    },
    **{
        "signal": {
            "SIGKILL",
            "SIGHUP",
            "SIGALRM",
            "SIGSTOP",
            "SIGUSR1",
            "SIGCHLD",
            "SIGPIPE",
            "pthread_sigmask",
            "alarm",
            "setitimer",
        }
    },
}
ASKING = {
    "exam/independent/command.py",  # hasattr
    "scenarios/tasks/processes.py",  # sys.platform, hasattr
    "scenarios/tasks/work.py",  # ImportError
    "scenarios/files/writing.py",  # hasattr
    "scenarios/files/sources.py",  # named pipes alone, which Windows has not
}


def _sources() -> Iterator[tuple[str, ast.Module]]:
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def sources() -> dict[str, ast.Module]:
    return dict(_sources())


def _absent(tree: ast.Module) -> list[str]:
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [name.name for name in node.names if name.name in ABSENT_MODULES]
        elif isinstance(node, ast.ImportFrom):
            found += (
                [node.module]
                if node.module in ABSENT_MODULES
                else [n.name for n in node.names if n.name in ABSENT.get(node.module or "", ())]
            )
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.attr in ABSENT.get(node.value.id, ())
        ):
            found.append(f"{node.value.id}.{node.attr}")
    return found


def test_what_windows_has_not_is_used_where_it_is_asked_for_first(
    sources: dict[str, ast.Module],
) -> None:
    using = {path: used for path, tree in sources.items() if (used := _absent(tree))}
    assert len(using) > 3
    assert {path: used for path, used in using.items() if path not in ASKING} == {}


def _calls(tree: ast.Module) -> Iterator[tuple[ast.Call, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield (
                node,
                node.func.attr
                if isinstance(node.func, ast.Attribute)
                else getattr(node.func, "id", ""),
            )


def _mode(call: ast.Call) -> str:
    """The mode of an ``open``: the second argument of the function, the first of a path's
    method.
    """
    at = 0 if isinstance(call.func, ast.Attribute) else 1
    given = [argument for argument in call.args[at : at + 1] if isinstance(argument, ast.Constant)]
    given += [
        word.value
        for word in call.keywords
        if word.arg == "mode" and isinstance(word.value, ast.Constant)
    ]
    return str(given[0].value) if given else "r"


def _needed(call: ast.Call, name: str) -> set[str]:
    """Arguments without which a call would read or write a text file as the machine likes it."""
    of = call.func.value if isinstance(call.func, ast.Attribute) else None
    if name in ("read_text", "write_text"):  # a function of ours that has such a name writes bytes
        return (
            set() if of is None else {"encoding"} | ({"newline"} if name == "write_text" else set())
        )
    if (
        name != "open"
        or (isinstance(of, ast.Name) and of.id in ("os", "webbrowser"))
        or "b" in _mode(call)
        or "devnull" in ast.unparse(call)
    ):
        return set()
    return {"encoding"} | ({"newline"} if set(_mode(call)) & set("wax") else set())


def test_text_files_have_one_coding_and_one_line_end(sources: dict[str, ast.Module]) -> None:
    """Without them a file is in the coding and with the line ends of the machine, so that the same
    seed has other bytes there.
    """
    needed = [
        (path, call, _needed(call, name))
        for path, tree in sources.items()
        for call, name in _calls(tree)
    ]
    wrong = [
        f"{path}:{call.lineno}"
        for path, call, words in needed
        if words - {word.arg for word in call.keywords}
    ]
    assert sum(bool(words) for _, _, words in needed) > 20 and wrong == []
