"""What an identification from a measured record returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ident.estimate import Estimate
from ident.flying_qualities.modes import Characteristics
from ident.statistics.intervals import ProfileInterval
from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Trained
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment.bounds import AtBound
from scenarios.identification.assessment.prediction import RecordFit
from scenarios.identification.input_reading import OtherReading
from scenarios.preparation.recording import NOTHING_SEEN, RawLook
from scenarios.studies.rows import Row
from sim.declaration.model import System
from sim.record import Record


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """What measured records say of a model: ``rows`` its parameters, ``biases`` the sensors' where the method gives them a sigma.

    ``record`` is the first; the other segments of a fit are ``others``. ``notes`` say how the records were prepared and the fit was made,
    ``doubts`` what in the files is likely to be wrong, ``cautions`` what in the result is, ``look`` what the raw columns show. ``reading``: what
    the other way to read inputs between samples changes, None where nothing is moved by more than a sigma or where it was not asked;
    ``decided`` the same where the data choose between the two.
    ``modes``: numbers of the modes from which levels of flying qualities follow, None where there are none. ``system``: the compiled model.
    ``tied``: parameters that follow others; ``at_bounds`` those that ended at a bound and are not among ``rows``. ``intervals`` by profile
    likelihood, where they were asked. ``fits``: each record simulated with the estimate, those held out last. ``band``: Hz, of a fit in
    the frequency domain. ``trained``: what another record is predicted with.
    ``engine``: of the filter, its ``name`` and a ``sentence``; empty without a filter.
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
    cautions: tuple[str, ...] = ()
    reading: OtherReading | None = None
    decided: OtherReading | None = None
    look: RawLook = NOTHING_SEEN
    modes: Characteristics | None = None
    system: System | None = None
    tied: tuple[Row, ...] = ()
    at_bounds: tuple[AtBound, ...] = ()
    intervals: tuple[ProfileInterval, ...] = ()
    fits: tuple[RecordFit, ...] = ()
    band: tuple[float, float] | None = None
    trained: Trained | None = None
    engine: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Identification: {self.vehicle.model} model of {self.vehicle.name} from {self.record!r}: {self.estimate!r}>"


@dataclass(frozen=True)
class Options:
    """What an identification is asked besides its method.

    ``profile``: parameters whose interval is wanted, empty for all, None for none. ``band``: Hz, of the frequency domain; None: from the data.
    ``engine``: of the extended Kalman filter, a key of ``ident.banks.delays.ENGINES``; None: filterpy for one filter, batched for a bank.
    """

    profile: tuple[str, ...] | None = None
    band: tuple[float, float] | None = None
    engine: str | None = None


PLAIN = Options()
