"""Cached runs of a scenario with changed values, for sliders, and the equivalent command line."""

from __future__ import annotations

import shlex
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from scenarios.studies.campaign import CampaignRuns
    from scenarios.studies.published import Row
    from scenarios.studies.study import MethodResult, StudyResult

KEPT = 64  # studies that are remembered: some hundred kB each
PREFIX = "flightid-"  # prefix of temporary folders
ALONE = "methods=[]"  # a change of a scenario: its main method alone


class Scratch:
    """A folder that lives as long as this object, or the process."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@lru_cache(KEPT)
def tried(name: str, changes: tuple[str, ...] = (), seed: int | None = None) -> StudyResult:
    """A scenario of estimators flown and estimated with changes as ``--set`` makes them. Errors as
    ``run_scenario``.
    """
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.study import run_scenario

    return run_scenario(load_scenario(name, changes), seed)


@lru_cache(KEPT)
def repeated(
    name: str, changes: tuple[str, ...], runs: int, seed: int | None = None
) -> CampaignRuns:
    """The same flight measured ``runs`` times and estimated by the main method. Errors as
    ``fly_campaign``.
    """
    from scenarios.studies.campaign import fly_campaign
    from scenarios.studies.catalogue import load_scenario

    return fly_campaign(load_scenario(name, changes), runs, seed)


def command(verb: str, name: str, changes: Sequence[str] = (), *options: str) -> str:
    """Return the equivalent command line for a shell, each ``--set`` on its own line."""
    return " \\\n  ".join(
        [
            shlex.join(["flightid", verb, name, *options]),
            *(f"--set {shlex.quote(change)}" for change in changes),
        ]
    )


def row_of(method: MethodResult, name: str) -> Row:
    """One parameter's row of a method."""
    return next(row for row in method.rows if row.name == name)


def residuals(found: StudyResult) -> dict[str, np.ndarray]:
    """What the main method leaves of each output ``(N,)``: of a filter its innovations."""
    estimate = found.main.result.estimate
    z, _ = found.record.output_array(estimate.output_names)
    return dict(zip(estimate.output_names, z - estimate.fitted[0], strict=True))


def sigmas_off(row: Row) -> float:
    """Estimate minus reference, in reported standard deviations."""
    assert row.reference is not None
    return (row.estimate - row.reference) / row.std


def close(value: float | None, to: float, within: float) -> bool:
    """Return whether an answer is within a share (``within``) of a number."""
    return value is not None and abs(value - to) <= within * abs(to)
