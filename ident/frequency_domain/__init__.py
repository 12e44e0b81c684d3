"""Maximum likelihood on the Fourier transforms of whole records, and on-line equation error.

Nothing is simulated, so that unstable motion is no difficulty. Biases and slow drifts have no
effect, since the lowest frequencies are left out. Theory: ``docs/estimators.md``.

May import `ident.regression`, `ident.statistics`, `ident.estimate` and the abstract part of `sim`.
Tests against oracles are in ``tests/unit/ident/frequency_domain``.
"""
