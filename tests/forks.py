"""Forks that a test asks after."""

from __future__ import annotations

import os

import pytest


def remembered_forks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of each process that is forked from here on, as forks return them; 0 in a fork
    itself.
    """
    helpers: list[int] = []
    fork = os.fork

    def remembered() -> int:
        helpers.append(fork())
        return helpers[-1]

    monkeypatch.setattr(os, "fork", remembered)
    return helpers
