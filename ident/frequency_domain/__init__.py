"""Maximum likelihood on the Fourier transforms of whole records.

Complex least squares on the Fourier transforms of whole records, for linear models: no simulation,
biases and slow drifts left out with the lowest frequencies, an unstable motion as easy as a stable
one. Theory: `docs/estimators.md`.

May import `ident.regression`, `ident.statistics`, `ident.estimate` and the abstract part of `sim`.
Oracles: `tests/unit/ident/frequency_domain`.
"""
