"""Differences between neighbouring samples: of a walk only these are independent of each other."""

from __future__ import annotations

import numpy as np


def differences(columns: np.ndarray) -> np.ndarray:
    """Differences of neighbouring samples of columns ``(m, N, c)``, the first sample itself; all outputs of a sample together: ``(N m, c)``."""
    m, n, c = columns.shape
    flat = np.empty((n, m, c))
    flat[0] = columns[:, 0]
    np.subtract(columns[:, 1:].transpose(1, 0, 2), columns[:, :-1].transpose(1, 0, 2), out=flat[1:])
    return flat.reshape(n * m, c)
