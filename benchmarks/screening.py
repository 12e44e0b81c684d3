"""What it costs to scan all candidates at one fitted set: those with a cause of their own, and the
general form (`varies:PARAMETER(SIGNAL)`).

    python benchmarks/screening.py [--runs N]

Records without anything missing of the `rigid`, `lateral` and `longitudinal` models. Times are
processor milliseconds of one process, the least of the runs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


def problems() -> dict[str, Any]:
    """A search's problem by model."""
    from ident.tracing.diagnosis import TraceSettings
    from ident.tracing.problem import TraceProblem
    from ident.tracing.wrong_samples import measured_masks
    from sim.vehicles.factory import model_from_constants
    from tests.tracing_problem import declared, doublets, planted
    from tests.whole_axes import CONSTANTS, TRUE, flown

    found = {}
    for kind in ("rigid", "lateral", "longitudinal"):
        if kind == "rigid":
            record, model = planted(seed=3, flight=doublets(20.0)), declared()
        else:
            record = flown(kind, 3)
            wrong = {name: 0.8 * value for name, value in TRUE[kind].items()}
            model = model_from_constants(kind, CONSTANTS[kind], wrong).with_biases(
                [channel.name for channel in record.outputs]
            )
        outputs = [channel.name for channel in record.outputs]
        found[kind] = TraceProblem(
            [record], measured_masks([record], outputs), model, (), outputs, TraceSettings()
        )
    return found


def least(act: Callable[[], object], runs: int) -> float:
    """Processor milliseconds of the quickest of some runs, one before them not counted."""
    times = []
    for _ in range(runs + 1):
        start = time.process_time()
        act()
        times.append(1000.0 * (time.process_time() - start))
    return min(times[1:])


def main() -> None:
    from ident.tracing.evidence import set_prior
    from ident.tracing.problem import search_context
    from ident.tracing.scan import leads_of, whitened_fit
    from ident.tracing.signatures import candidate_signatures
    from scenarios.diagnosis.opening import candidates_for

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    print("model         samples  whitened ms  named  their ms  instances  their ms  ms each")
    for kind, problem in problems().items():
        fitted = problem.fit((), None)
        context, every = search_context(fitted), candidates_for(problem.model)
        prior = set_prior(fitted, context)
        whitened = whitened_fit(fitted, prior)
        named, instances = (
            [c for c in every if c.traits.general is wanted] for wanted in (False, True)
        )
        first = least(lambda f=fitted, p=prior: whitened_fit(f, p), runs)
        known = least(
            lambda f=fitted, r=whitened, e=named, c=context: leads_of(
                f, r, [*candidate_signatures(f, e, c).values()], c
            ),
            runs,
        )
        general = least(
            lambda f=fitted, r=whitened, e=instances, c=context: leads_of(
                f, r, [*candidate_signatures(f, e, c).values()], c
            ),
            runs,
        )
        counts = (
            f"{len(problem.records[0]):7}  {first:11.1f}  {len(named):5}  {known:8.0f}  "
            f"{len(instances):9}"
        )
        print(f"{kind:12}  {counts}  {general:8.1f}  {general / len(instances):7.2f}")


if __name__ == "__main__":
    main()
