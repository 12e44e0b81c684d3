"""Decide by posterior probabilities of sets of effects, from files alone, as `diagnose` would.

It stands beside the decisions of the installed loop; both can be graded on the same flights:
``python -m exam independent --score DIR --out DIR --command "python -m exam by-evidence"``.
"""

from __future__ import annotations

import json
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ident.tracing.candidate_model.problem import TraceProblem
    from ident.tracing.evidence.decision import Decision, Named


def main(arguments: Sequence[str] | None = None) -> int:
    """Run on the line that an examination gives to `diagnose`; writes ``diagnosis.json``."""
    parser = ArgumentParser(prog="python -m exam by-evidence", description=__doc__)
    parser.add_argument("command", choices=("diagnose",))
    parser.add_argument("records", nargs="+", type=Path)
    parser.add_argument("--model", required=True)
    parser.add_argument("--vehicle", type=Path, required=True)
    parser.add_argument("--validate", type=Path, nargs="*", default=[])
    parser.add_argument("--map", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--no-figures", action="store_true")
    parser.add_argument("--quiet", action="store_true")
    asked = parser.parse_args(arguments)
    begun = time.process_time()
    content = _content(_decided(asked)) | {"seconds": time.process_time() - begun}
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps(content, indent=1)
        (asked.out / "diagnosis.json").write_text(text, encoding="utf-8", newline="\n")
    if not asked.quiet:
        print(json.dumps(content, indent=1))
    return 0


def _decided(asked: Namespace) -> Decision:
    from ident.tracing.evidence.decision import decided
    from sim.effects.library import effects_for
    from sim.effects.model_discrepancy import discrepancy_for

    problem = problem_of(asked)
    return decided(problem, discrepancy_for(effects_for(problem.model.equations)))


def problem_of(asked: Namespace) -> TraceProblem:
    """Everything of a diagnosis before its first fit, by the readers that `diagnose` uses."""
    from ident.tracing.candidate_model.problem import TraceProblem
    from ident.tracing.settings import TraceSettings
    from ident.tracing.spikes.masks import measured_masks
    from scenarios.diagnosis.candidates import can_act, candidates_for
    from scenarios.diagnosis.opening import opened_files, posed_for, vehicle_path_of
    from scenarios.preparation.request import Request
    from scenarios.preparation.vehicle_model import step_for
    from sim.effects.library import guards_for

    request = Request(
        records=tuple(asked.records),
        vehicle=asked.vehicle,
        model=asked.model,
        validate=tuple(asked.validate),
    )
    if asked.map is not None:
        request = replace(request, channels=asked.map)
    opened = opened_files(request, vehicle_path_of(request))
    posed = posed_for(opened, request.plan)
    usual = TraceSettings()
    step = step_for(posed.model, posed.records, usual.max_step)
    candidates = candidates_for(posed.model, ())
    guards = can_act(guards_for(posed.model.equations), posed.model)
    outputs = [
        signal.name
        for signal in posed.model.equations.outputs
        if any(signal.name in record.output_names for record in posed.records)
    ]
    return TraceProblem(
        posed.records,
        measured_masks(posed.records, outputs),
        posed.model,
        (*candidates, *guards),
        outputs,
        replace(usual, max_step=step),
        posed.predicted,
    )


def _content(found: Decision) -> dict[str, Any]:
    claimed = [_effect(found, named, claimed=True) for named in found.named]
    hints = [_effect(found, named, claimed=False) for named in found.hints]
    return {
        "verdict": found.verdict.value,
        "effects": claimed + hints,
        "inclusion": {name: round(share, 4) for name, share in sorted(found.inclusion.items())},
        "fits": found.fits,
    }


def _effect(found: Decision, named: Named, *, claimed: bool) -> dict[str, Any]:
    from ident.tracing.candidate_model.quantities import quantities

    (effect,) = [each for each in found.best.effects if each.name == named.name]
    values = quantities(found.best, effect)
    return {
        "name": named.name,
        "claimed": claimed,
        "probability": named.probability,
        "spread": named.spread,
        "alternatives": [name for name, share in named.alternatives.items() if share > 0.05],
        "parameters": {
            name: {"value": each.value, "std": each.std, "unit": each.unit}
            for name, each in values.items()
        },
    }
