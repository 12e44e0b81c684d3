"""What a record determines of a method's parameters, linearised at its estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate
from ident.statistics.information import Determination, determination
from ident.whole_record.layout import weighted_sensitivities
from scenarios.studies.declaration import Estimation
from scenarios.studies.estimating import biased_system
from sim.declaration.model import Model
from sim.record import Record


@dataclass(frozen=True, eq=False)
class MethodDetermination:
    """What record and priors of one method say, and the deviations ``claimed (n,)`` that the method itself states, in the same order."""

    estimation: Estimation
    found: Determination
    claimed: np.ndarray

    @property
    def overclaimed(self) -> tuple[str, ...]:
        """Parameters with a stated deviation below ``HONEST`` of what record and prior together allow."""
        ratio = self.claimed / self.found.posterior_std
        return tuple(name for name, value in zip(self.found.names, ratio.tolist(), strict=True) if value < HONEST)


HONEST = 0.8  # the nonlinearity of these records and the noise level found from one change a deviation by a tenth


def determine(estimation: Estimation, record: Record, model: Model, estimate: Estimate) -> MethodDetermination:
    """What ``record`` and the priors of ``model`` say of the parameters, at the estimate and with the noise that the model declares.

    No process noise: what a filter counts as such can only hide more. Biases of the sensors count as unknown, as in whole-record fits.
    """
    system = biased_system(estimation, model.with_values(estimate.only(model.parameters.free_names).as_dict()))
    noise = np.array([model.noise.measurement_std[name] for name in system.output_names])
    names, slopes = weighted_sensitivities(record, system, noise)
    found = determination(names, slopes, np.array([estimation.start[name].std for name in names]))
    return MethodDetermination(estimation, found, np.array([estimate.sigma(name) for name in names]))
