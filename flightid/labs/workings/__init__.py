"""What the labs compute, without a notebook: functions of the sliders' values, which notebooks,
keys and tests share.

Here are the parts of all labs: a scenario run with changed values, its result kept, and the
equivalent command line.
"""

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
    from scenarios.studies.declaration import Row
    from scenarios.studies.study import MethodResult, StudyResult

KEPT = 64  # studies in the cache, some hundred kB each
PREFIX = "flightid-"  # prefix of temporary folders
MAIN_METHOD_ONLY = "methods=[]"  # change of a scenario: no methods besides its main one


class Scratch:
    """A temporary folder, which is removed with this object or at the end of the process."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@lru_cache(KEPT)
def scenario_study(
    name: str, changes: tuple[str, ...] = (), seed: int | None = None
) -> StudyResult:
    """Return the study of a scenario with changes as by ``--set``. Errors as ``run_scenario``."""
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.study import run_scenario

    return run_scenario(load_scenario(name, changes), seed)


@lru_cache(KEPT)
def scenario_campaign(
    name: str, changes: tuple[str, ...], runs: int, seed: int | None = None
) -> CampaignRuns:
    """Return a campaign of the main method with ``runs`` runs. Errors as ``fly_campaign``."""
    from scenarios.studies.campaign import fly_campaign
    from scenarios.studies.catalogue import load_scenario

    return fly_campaign(load_scenario(name, changes), runs, seed)


def command(verb: str, name: str, changes: Sequence[str] = (), *options: str) -> str:
    """Return the equivalent command line for a shell, each ``--set`` on its own line."""
    settings = (f"--set {shlex.quote(change)}" for change in changes)
    return " \\\n  ".join([shlex.join(["flightid", verb, name, *options]), *settings])


def row_of(method: MethodResult, name: str) -> Row:
    """Return a parameter's row of a method."""
    return next(row for row in method.rows if row.name == name)


def residuals(found: StudyResult) -> dict[str, np.ndarray]:
    """Return the residuals of the main method by output, ``(N,)``; innovations of a filter."""
    estimate = found.main.result.estimate
    z, _ = found.record.output_array(estimate.output_names)
    return dict(zip(estimate.output_names, z - estimate.fitted[0], strict=True))


def sigmas_off(row: Row) -> float:
    """Return the error of an estimate, in reported standard deviations."""
    assert row.sigmas is not None
    return row.sigmas


def close(value: float | None, to: float, within: float) -> bool:
    """Return whether an answer is within a share (``within``) of a number."""
    return value is not None and abs(value - to) <= within * abs(to)
