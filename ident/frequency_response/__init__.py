"""Frequency responses of records, with coherence and random errors.

`estimate.py` is where to begin. May import the abstract part of `sim`. Oracles:
`tests/unit/ident/frequency_response`.
"""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    EvenSignals,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "EvenSignals", "FrequencyResponses", "Spectra", "estimate_responses"]
