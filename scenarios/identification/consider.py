"""Standard deviations of estimates with the uncertainty of constants that are not estimated.

Mass, inertias, density and airspeed are held in a fit, and errors in them move the estimates. With
s_i the change of the estimates for one standard deviation of constant i, and independent
constants, the covariance is P + sum_i s_i s_i' ("consider" parameters [1]_). The change is half the
difference of two estimates with the same method and records, one sigma of the constant apart on
either side; it holds what is not linear in that distance, and every method has it.

References
----------
.. [1] B. D. Tapley, B. E. Schutz and G. H. Born, Statistical Orbit Determination, Elsevier, 2004,
   chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome
from scenarios.report.document import BY_ROW, Cell, Column, Table, formatted, table
from scenarios.report.quantities import shown_in
from sim.declaration.model import Model

CAPTION = "Standard deviations with the uncertainty of constants"
DATA = "data"
_SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


@dataclass(frozen=True, eq=False)
class Considered:
    """Contributions to the standard deviations of estimates.

    Attributes
    ----------
    names, units : of the ``n`` parameters.
    constants : the ``k`` constants whose uncertainty counts, with ``sigmas`` in their units.
    data : ``(n,)`` standard deviations from the data alone, constants taken as exact.
    moved : ``(k, n)`` change of each estimate for one standard deviation of each constant, signed.
    failed : constants with which the fit did not settle; they count nothing.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    constants: tuple[str, ...]
    sigmas: tuple[float, ...]
    data: np.ndarray
    moved: np.ndarray
    failed: tuple[str, ...] = ()

    @property
    def total(self) -> np.ndarray:
        """Standard deviations with the constants' share, ``(n,)``."""
        return np.sqrt(self.data**2 + np.sum(self.moved**2, axis=0))

    @property
    def shares(self) -> np.ndarray:
        """Shares of the variance, ``(k + 1, n)``, the data's first; each column sums to one."""
        variance = np.vstack([self.data**2, self.moved**2])
        whole = variance.sum(axis=0)
        return variance / np.where(whole > 0.0, whole, 1.0)

    def dominant(self, name: str) -> str:
        """The constant with the largest share of a parameter's variance, or ``"data"``."""
        place = int(np.argmax(self.shares[:, self.names.index(name)]))
        return (DATA, *self.constants)[place]


def consider(
    model: Model,
    sigmas: Mapping[str, float],
    estimate: Estimate,
    estimated: Callable[[Model], Estimate],
) -> tuple[Estimate, Considered | None]:
    """An estimate with the uncertainty of constants in its covariance, and what contributes.

    Parameters
    ----------
    model : as it was fitted, with its constants. sigmas : standard deviation of each uncertain
        constant, in the constant's unit. estimate : the model's, from the data alone.
    estimated : the same estimation of another model.

    Returns
    -------
    The estimate with the larger covariance, and the contributions; without ``sigmas``, or where the
    estimate has not settled, the same estimate and None.

    Raises
    ------
    What ``estimated`` raises.
    """
    if not sigmas or estimate.outcome not in _SETTLED:
        return estimate, None
    held = {item.name: item.value for item in model.parameters if not item.free}
    moved, used, failed = [], [], []
    for name, sigma in sigmas.items():
        if name not in held:
            continue
        ends = [
            estimated(model.with_values({name: held[name] + side * sigma})) for side in (1.0, -1.0)
        ]
        change = 0.5 * (ends[0].values - ends[1].values) if _alike(estimate, ends) else None
        if change is None or not np.all(np.isfinite(change)):
            failed.append(name)
            continue
        used.append(name)
        moved.append(change)
    rows = np.array(moved).reshape(len(used), len(estimate.names))
    considered = Considered(
        estimate.names,
        estimate.units,
        tuple(used),
        tuple(sigmas[name] for name in used),
        estimate.std,
        rows,
        tuple(failed),
    )
    return replace(estimate, covariance=estimate.covariance + rows.T @ rows), considered


def _alike(estimate: Estimate, ends: list[Estimate]) -> bool:
    return all(each.names == estimate.names and each.outcome in _SETTLED for each in ends)


def considered_sentences(considered: Considered | None) -> list[str]:
    """Cautions about constants whose uncertainty could not be counted."""
    if considered is None or not considered.failed:
        return []
    names = ", ".join(considered.failed)
    return [
        f"the uncertainty of {names} is not in the sigmas: the fit does not settle one standard "
        "deviation away; state a smaller one, or begin nearer"
    ]


def considered_table(considered: Considered, parameters: tuple[str, ...]) -> Table:
    """Sigmas from the data and in all, and shares of the variance, for some parameters."""
    places = [considered.names.index(name) for name in parameters if name in considered.names]
    names = [considered.names[i] for i in places]
    shown = [shown_in(considered.units[i], considered.names[i]) for i in places]
    data, total, shares = considered.data, considered.total, considered.shares
    pairs = list(zip(places, (unit.factor for unit in shown), strict=True))
    return table(
        CAPTION,
        (Column("parameter"), names),
        (Column("sigma, data", BY_ROW), [_sigma(data[i] * factor) for i, factor in pairs]),
        (Column("sigma, all", BY_ROW), [_sigma(total[i] * factor) for i, factor in pairs]),
        *(
            (Column(source, "%"), [formatted(100.0 * shares[k, i], ".0f") for i in places])
            for k, source in enumerate((DATA, *considered.constants))
        ),
        (Column("dominant"), [considered.dominant(name) for name in names]),
        units=[unit.unit for unit in shown],
    )


def _sigma(value: float) -> Cell:
    return formatted(float(value), ".2g")


def considered_content(considered: Considered | None) -> dict[str, Any]:
    """The contributions for comparison.json; empty where no constant is uncertain."""
    if considered is None:
        return {}
    return {
        "uncertain_constants": {
            "sigmas": dict(zip(considered.constants, considered.sigmas, strict=True)),
            "parameters": {
                name: {
                    "std_data": float(considered.data[i]),
                    "std": float(considered.total[i]),
                    "moved": {
                        constant: float(considered.moved[k, i])
                        for k, constant in enumerate(considered.constants)
                    },
                    "dominant": considered.dominant(name),
                }
                for i, name in enumerate(considered.names)
            },
            **({"not_counted": list(considered.failed)} if considered.failed else {}),
        }
    }
