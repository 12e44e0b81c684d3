"""Frequency responses of records, with coherence and random errors."""

from ident.frequency_response.estimate import (
    LEAST_COHERENCE,
    FrequencyResponses,
    Signals,
    Spectra,
    estimate_responses,
)

__all__ = ["LEAST_COHERENCE", "FrequencyResponses", "Signals", "Spectra", "estimate_responses"]
