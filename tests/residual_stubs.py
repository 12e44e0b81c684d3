"""Residuals of one record that stand for a prediction of it, where a test needs nothing else of a
fit.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np

from ident.whole_record.gauss_newton import Fit


def left_by(residual: np.ndarray, valid: np.ndarray | None = None) -> Fit:
    """What a prediction of one record leaves, ``(m, N)``; every sample counts unless ``valid`` says
    which do.
    """
    counted = np.ones(residual.shape, dtype=bool) if valid is None else valid
    layout = SimpleNamespace(
        problems=(SimpleNamespace(valid=counted),), used=np.ones(len(residual), dtype=bool)
    )
    return cast(
        "Fit", SimpleNamespace(layout=layout, residuals=(residual,), counts=counted.sum(axis=1))
    )
