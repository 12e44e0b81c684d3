"""Frequency responses of records, with coherence and random errors.

Start with `estimate.py`. May import `sim.declaration`, `sim.errors`, `sim.maths`, `sim.record`.
Oracles: `tests/unit/ident/frequency_response`.
"""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    EvenSignals,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "EvenSignals", "FrequencyResponses", "Spectra", "estimate_responses"]
