"""What an identification from a measured record returns."""

from __future__ import annotations

from dataclasses import dataclass

from ident.estimate import Estimate
from ident.statistics.residuals import ResidualTest
from scenarios.files.vehicles import VehicleFile
from scenarios.preparation.recording import NOTHING_SEEN, RawLook
from scenarios.studies.rows import Row
from sim.record import Record


@dataclass(frozen=True, eq=False)
class Identification:
    """What measured records say of a model: ``rows`` its parameters, ``biases`` the sensors' where the method gives them a sigma.

    ``record`` is the first; the other segments of a fit are ``others``. ``notes`` say how the records were prepared,
    ``doubts`` what in the files is likely to be wrong, ``look`` what their raw columns show.
    """

    record: Record
    vehicle: VehicleFile
    method: str
    estimate: Estimate
    rows: tuple[Row, ...]
    biases: tuple[Row, ...]
    derived: dict[str, tuple[float, float]]
    fixed: dict[str, tuple[float, str]]
    tests: tuple[ResidualTest, ...]
    others: tuple[Record, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    look: RawLook = NOTHING_SEEN
