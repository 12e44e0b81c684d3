"""What a tracing scenario declares: the truth with what is hidden in it, the maneuvers, what the loop is told, what it should find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from scenarios.studies.declaration import ManeuverPlan
from sim.declaration.model import Model

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class HiddenTerm:
    """Something that acts and that the declared model lacks.

    ``name`` is that of a library effect or, with ``own:``, of a term in `scenarios.trials.hidden`. ``values`` are its local
    parameters (SI); ``elsewhere`` those that differ in the other two records, as the time of an event does.
    """

    name: str
    values: Mapping[str, float]
    elsewhere: Mapping[str, float] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True)
class RecordPlan:
    """How one record is flown: duration (s) and maneuvers."""

    duration: float
    maneuvers: tuple[ManeuverPlan, ...] = ()


@dataclass(frozen=True)
class TraceFlight:
    """The truth recipe of both records.

    Attributes
    ----------
    vehicle : name of a built-in vehicle, ``"x29-S"`` for the closed loop with that airframe, or a user's model file, whose model with its true
        values is ``own``. modes : elastic modes that act.
    rate : 1/s; of a closed loop its telemetry's. step : integration step, s. noise_std : by output; of a closed loop its telemetry's.
    train, validate : the two records. hidden : what acts beyond the vehicle.
    test : a third record, which takes no part in fitting or in choosing; None flies the maneuvers of ``validate`` once more.
    """

    vehicle: str
    train: RecordPlan
    validate: RecordPlan
    hidden: tuple[HiddenTerm, ...]
    noise_std: Mapping[str, float] = field(default_factory=lambda: _NONE)
    rate: float = 50.0
    step: float = 0.001
    modes: int = 0
    own: Model | None = None
    test: RecordPlan | None = None

    @property
    def test_plan(self) -> RecordPlan:
        """How the third record is flown."""
        return self.validate if self.test is None else self.test


@dataclass(frozen=True)
class Expectation:
    """What the loop should find: any of ``verdicts``, and, where effects are claimed, any of the sets ``effects``."""

    verdicts: tuple[str, ...]
    effects: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class TraceScenario:
    """A named study of the tracing loop.

    Attributes
    ----------
    name, title, about : for people. distance : how far the truth is from the model, and whether the library has what lies between.
    flight : the truth recipe; ``model`` what the loop is told it is, a name or a user's model file.
    wrong : share by which the vehicle file's starting values are off, sign by turns; ``start`` are values that are given instead.
    expect : what should be found. seed : used unless another is asked for. effort : how far the search looks, normal or thorough.
    """

    name: str
    title: str
    about: str
    distance: str
    flight: TraceFlight
    model: str
    expect: Expectation
    wrong: float = 0.3
    start: Mapping[str, float] = field(default_factory=lambda: _NONE)
    seed: int = 1
    effort: str = "normal"
