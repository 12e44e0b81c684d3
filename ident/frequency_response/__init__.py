"""Frequency responses of records, with coherence and random errors, and models fitted to them.

May import the abstract part of `sim`. Tests with known responses are in
``tests/unit/ident/frequency_response``. Theory: ``docs/estimators.md``.
"""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    EvenSignals,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "EvenSignals", "FrequencyResponses", "Spectra", "estimate_responses"]
