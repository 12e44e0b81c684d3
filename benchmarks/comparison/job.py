"""What a job is: a problem, who solves it, and how near the answers must be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

Problem = Mapping[str, np.ndarray]
Answer = Mapping[str, np.ndarray]


class Agreement(NamedTuple):
    """What a check says of one contender's answer, and whether it is near enough to count as the
    same work.
    """

    said: str
    near: bool


@dataclass(frozen=True)
class Contender:
    """Who does a job.

    Attributes
    ----------
    module : file in `benchmarks.peers`; its ``prepare(problem)`` returns the work, a function
    without arguments that returns the answer. label : as the page shows it. package : whose version
    the page shows, empty for none. needs : packages without which it is not installed. tolerance :
    of the job's check. share : of the work that it does; its times are divided by it, and the page
    says so. missing : says what is not there besides packages, empty where all is.
    """

    module: str
    label: str
    package: str = ""
    needs: tuple[str, ...] = ()
    tolerance: float = 1e-6
    share: float = 1.0
    missing: Callable[[], str] = lambda: ""

    @property
    def absent(self) -> str:
        """Why it cannot take part, empty where it can."""
        gone = [name for name in self.needs if find_spec(name) is None]
        return f"{', '.join(gone)} not installed" if gone else self.missing()

    @property
    def version(self) -> str:
        """Version of its package, empty where it has none."""
        try:
            return metadata.version(self.package) if self.package else ""
        except metadata.PackageNotFoundError:
            return ""


@dataclass(frozen=True)
class Job:
    """One piece of work for several contenders.

    Attributes
    ----------
    name : for `--jobs`. title, about : for the page; about says what is the same for all and what
    is not. ours : flightid, to which all times are related. peers : the others. problem : of the
    full size, or with True of a small one. check : problem, our answer, another's, its tolerance.
    """

    name: str
    title: str
    about: str
    ours: Contender
    peers: tuple[Contender, ...]
    problem: Callable[[bool], Problem]
    check: Callable[[Problem, Answer, Answer, float], Agreement]

    @property
    def contenders(self) -> tuple[Contender, ...]:
        return (self.ours, *self.peers)
