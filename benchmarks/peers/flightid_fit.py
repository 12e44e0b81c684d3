"""flightid's output-error fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.flightid_model import declared, record_of
from benchmarks.peers.names import OUTPUTS
from benchmarks.peers.short_period import Problem
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    record, system = record_of(problem), compile_model(declared(problem, start_known=True), OUTPUTS)

    def work() -> dict[str, np.ndarray]:
        found = fit_output_error([record], system, FitSettings())
        return {"estimate": found.values, "estimate_std": found.std}

    return work
