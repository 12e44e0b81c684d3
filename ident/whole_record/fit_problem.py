"""What a whole-record fit solves: the unknowns laid out over the records, and the model of what is random in the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.whole_record.layout import FitLayout
from ident.whole_record.noise_model import WHITE, NoiseModel


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A layout and a noise model; in theta the noise model's own unknowns stand behind those of the layout."""

    layout: FitLayout
    noise_model: NoiseModel = WHITE

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns."""
        return (*self.layout.names, *self.noise_model.names)

    @property
    def start(self) -> np.ndarray:
        """Where the fit begins, ``(n,)``."""
        return np.concatenate([self.layout.start, self.noise_model.start])

    @property
    def low(self) -> np.ndarray:
        """Lowest values, ``(n,)``."""
        return np.concatenate([self.layout.low, self.noise_model.low])

    @property
    def high(self) -> np.ndarray:
        """Highest values, ``(n,)``."""
        return np.concatenate([self.layout.high, self.noise_model.high])
