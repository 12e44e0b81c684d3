"""What ``help()`` shows: each argument of a public function begins a line of its own."""

from __future__ import annotations

import inspect
import re

import pytest

import flightid as fid

FUNCTIONS = [
    name
    for name in fid.__all__
    if inspect.isfunction(getattr(fid, name))
    and "Parameters\n" in (inspect.getdoc(getattr(fid, name)) or "")
]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_names_each_argument_at_the_start_of_a_line(name: str) -> None:
    function = getattr(fid, name)
    text = (inspect.getdoc(function) or "").partition("Parameters\n----------\n")[2]
    entries = re.split(r"\n\n[A-Z][a-z]+\n-+\n", text)[0].splitlines()
    told = {
        word
        for line in entries
        if (head := re.match(r"((?:\*{0,2}\w+, )*\*{0,2}\w+) :", line)) is not None
        for word in re.split(r", \*{0,2}|^\*{1,2}", head[1])
    }
    assert set(inspect.signature(function).parameters) <= told


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_does_not_send_to_the_command(name: str) -> None:
    assert "as the command's options" not in (inspect.getdoc(getattr(fid, name)) or "")
