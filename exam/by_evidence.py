"""`diagnose` deciding by posterior probabilities of sets of effects, in the place of the installed loop.

Both can be graded on the same flights:
``python -m exam independent --score DIR --out DIR --command "python -m exam by-evidence"``.
"""

from __future__ import annotations

from argparse import REMAINDER, ArgumentParser
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

if TYPE_CHECKING:
    from ident.tracing.diagnosis import Diagnosis
    from sim.declaration.model import Model
    from sim.record import Record


def main(arguments: Sequence[str] | None = None) -> int:
    """The program's command line (``diagnose RECORD... --model M ...``) with the other loop in it."""
    from scenarios.cli import main as program
    from scenarios.diagnosis import diagnose

    what = "`diagnose` deciding by posterior probabilities of sets of effects"
    parser = ArgumentParser(prog="python -m exam by-evidence", description=what)
    parser.add_argument("line", nargs=REMAINDER, help="diagnose RECORD... --model M ...")
    line = parser.parse_args(arguments).line
    with patch.object(diagnose, "_loop", lambda: by_evidence):
        program(line)
    return 0


def by_evidence(records: Sequence[Record], model: Model, *given: Any, **options: Any) -> Diagnosis:
    """The loop with a model discrepancy of the loads of the model's equations.

    Parameters
    ----------
    records, model, given, options : those of `ident.tracing.evidence.loop.diagnose_by_evidence`.
    """
    from ident.tracing.evidence.loop import diagnose_by_evidence
    from sim.effects.library import effects_for
    from sim.effects.model_discrepancy import discrepancy_for

    discrepancy = discrepancy_for(effects_for(model.equations))
    return diagnose_by_evidence(records, model, *given, **options, discrepancy=discrepancy)
