"""Frequency responses of records, with coherence and random errors.

The main file is `estimate.py`. The package may import `sim.declaration`, `sim.errors`, `sim.maths`
and `sim.record`. Tests with known responses are in `tests/unit/ident/frequency_response`.
"""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    EvenSignals,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "EvenSignals", "FrequencyResponses", "Spectra", "estimate_responses"]
