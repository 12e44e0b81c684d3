"""Frequency responses of records, with coherence and random errors."""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    EvenSignals,
    FrequencyResponses,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "EvenSignals", "FrequencyResponses", "Spectra", "estimate_responses"]
