"""Numbers beyond all range in a search: counted, told in one line, and no warning of NumPy on the
terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ident.tracing.diagnosis import Data, Diagnosis
from ident.tracing.settings import TraceSettings
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record


class Trace(Protocol):
    """The tracing loop, ``ident.tracing.loop.diagnose``."""

    def __call__(
        self,
        records: Sequence[Record],
        model: Model,
        candidates: Sequence[Traceable],
        guards: Sequence[Traceable],
        validation: Sequence[Record],
        settings: TraceSettings,
        progress: Callable[[str, float], None],
        *,
        kinematics: Callable[[], Sequence[tuple[str, ...]]] | None,
        reread: Callable[[], Data] | None,
    ) -> Diagnosis: ...


@dataclass
class Overflows:
    """How often a computation left the range of numbers; the loop leaves out what it would have
    shown.
    """

    count: int = 0

    def __call__(self, kind: str, flag: int) -> None:
        """NumPy's call where a result overflows or is no number."""
        self.count += 1

    def counted(self, trace: Trace) -> Trace:
        """The same loop, its overflows counted instead of warned of; a share below the smallest
        number is none.
        """

        def counting(*arguments: Any, **named: Any) -> Diagnosis:
            with np.errstate(over="call", invalid="call", divide="call", under="ignore", call=self):
                return trace(*arguments, **named)

        return counting


def overflow_sentence(count: int) -> str:
    """One line on what was left out; empty where nothing was."""
    if count == 0:
        return ""
    several = f"{count} computations" if count > 1 else "one computation"
    return (
        f"{several} of the search left the range of numbers: what they would have shown is left "
        "out; look for wild samples and wrong units"
    )
