"""Docstrings of what `flightid` exports: each has one, and the examples in them run."""

from __future__ import annotations

import doctest
import importlib
import inspect

import pytest

import flightid

FUNCTIONS = [name for name in flightid.__all__ if inspect.isfunction(getattr(flightid, name))]
MODULES = [
    "scenarios.api.checks",
    "scenarios.api.design",
    "scenarios.api.diagnosis",
    "scenarios.api.estimators",
    "scenarios.api.identification",
    "scenarios.api.tables",
    "scenarios.api.plot",
    "scenarios.api.record",
    "scenarios.api.design",
    "scenarios.api.study",
    "scenarios.api.tables",
    "scenarios.api.vehicle",
    "scenarios.report.folder",
    "sim.declaration.user_model",
]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_shows_an_example(name: str) -> None:
    text = inspect.getdoc(getattr(flightid, name)) or ""
    assert len(text.splitlines()) > 1
    assert ">>> " in text


@pytest.mark.sampled
@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name: str) -> None:
    done = doctest.testmod(importlib.import_module(name))
    assert done.attempted > 0 and done.failed == 0


def test_every_example_is_of_a_module_that_runs() -> None:
    homes = {getattr(flightid, name).__module__ for name in FUNCTIONS}
    assert homes <= set(MODULES)
