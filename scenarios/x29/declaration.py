"""What a scenario of the closed loop declares: how it is flown, how the low-order filter is set up, what stands beside the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from scenarios.studies.declaration import Choice

_NONE: Mapping[str, float] = MappingProxyType({})
# Ways to estimate one record that a scenario may have beside its own: what each is called in a table.
METHODS: Mapping[str, str] = MappingProxyType(
    {
        "paper": "the paper's: plain bank, printed P0",
        "paper-other": "its filter on the record's other side",
        "paper-density": "the paper's, printed Q as a density",
        "plain-quarter": "plain bank, P0 a quarter of the start",
        "held": "plain filter at the refined delay",
        "relinearised": "linearised anew at the bank's delay",
        "refined-printed": "refined, printed P0",
        "refined-quarter": "refined, P0 a quarter of the start",
    }
)


@dataclass(frozen=True)
class StickPlan:
    """The pilot's input: ``kind`` 3-2-1-1, doublet, levels or hand-flown, and its numbers (s, in, rad/s).

    ``times`` and ``levels`` are those of ``levels``; ``pilot_seed`` draws the hand-flown history, apart from the noise.
    """

    kind: str
    amplitude: float = 1.0
    unit: float = 0.5
    start: float = 1.0
    bandwidth: float = 10.0
    pilot_seed: int = 1
    times: tuple[float, ...] = ()
    levels: tuple[float, ...] = ()


@dataclass(frozen=True)
class Spike:
    """One sample of the recorded stick that is wrong: its time (s) and what the record says there (in)."""

    time: float
    size: float


@dataclass(frozen=True)
class LoopFlight:
    """How the closed loop is flown.

    Attributes
    ----------
    airframe : ``"P"``, ``"S"``, ``"F"``, ``"D"`` or ``"R"``. duration : s.
    noise : whether the telemetry is noisy.
    dead_band, curvature : of the stick, in and 1/in; None keeps the aircraft's.
    rate_limits : whether the rams have their rate limits.
    low_order : fly the loop's own low-order equivalent instead of the loop, to see what the model's order does.
    gust : spectral density of white vertical-gust forcing of the low-order truth's pitch rate, (rad/s2)^2 s; 0 without.
    spike : in the recorded stick; the control computer did not see it.
    noise_std : of the telemetry by output, rad, rad/s and g; empty keeps the aircraft's.
    """

    airframe: str
    duration: float
    stick: StickPlan
    noise: bool = True
    dead_band: float | None = None
    curvature: float | None = None
    rate_limits: bool = True
    low_order: bool = False
    gust: float = 0.0
    spike: Spike | None = None
    noise_std: Mapping[str, float] = field(default_factory=lambda: _NONE)


@dataclass(frozen=True)
class LoopEstimation:
    """How the record is estimated.

    Attributes
    ----------
    start : starting values by name; of ``start_from`` where that names another scenario, whose plain bank then runs first.
    noise_from : ``"sensors"`` takes the sensors' sigma, ``"envelope"`` reads it off the record; times ``noise_share``.
    process_noise : spectral densities by state, (unit/s)^2 s.
    initial_std : of alpha, q and delta at the window's begin; of alpha and q the noise's where not given, as in the paper.
    window_start, window_stop : part of the record that is used, s.
    prior : P0 of the parameters: ``"quarter"`` of the start, or ``"printed"`` as in the paper's Tables 1 and 2.
    restarts : start the refined filter again from its own result until it settles, at most so often.
    engine : who runs the filters, a key of ``ident.banks.delays.ENGINES``; the result is the same.
    """

    start: Mapping[str, float]
    start_from: str
    noise_from: str
    noise_share: float
    process_noise: Mapping[str, float]
    initial_std: Mapping[str, float] = field(default_factory=lambda: _NONE)
    window_start: float | None = None
    window_stop: float | None = None
    restarts: int = 0
    prior: str = "quarter"
    engine: str = "batched"


@dataclass(frozen=True)
class Against:
    """Another scenario, with changes as ``--set`` makes them, whose result this one is compared with."""

    scenario: str
    label: str
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class MarginPlan:
    """How much is varied of what the paper leaves open of the margins: ``samples`` points of a Latin hypercube (none: the study is left
    out), their ``seed``, and an airframe to show ``beside`` the two."""

    samples: int
    seed: int = 1
    beside: str = ""


@dataclass(frozen=True)
class Variant:
    """The same scenario flown or estimated differently, to see what an observation hangs on."""

    name: str
    label: str
    flight: LoopFlight
    estimation: LoopEstimation


@dataclass(frozen=True)
class LoopScenario:
    """A named study of the closed loop.

    Attributes
    ----------
    published : columns of the paper's tables to print, the scenario's own first.
    against : what the result is compared with. together : scenarios printed side by side as the paper's Table 3.
    methods : names of ``METHODS`` whose results stand beside the scenario's own. margins : what is varied of the loop's margins.
    variants : see ``Variant``. stretch : an interval (s) whose misfit is told apart from the rest. peak : an interval with a final peak.
    choices : values that no source gives. seeds : flights with the seeds 1 to this one that the paper's bank estimates, too; 0 for none.
    findings : what holds or stays open whatever the numbers are, in words, to be read with what is computed from them.
    """

    name: str
    title: str
    about: str
    distance: str
    flight: LoopFlight
    estimation: LoopEstimation
    published: tuple[str, ...] = ()
    against: Against | None = None
    together: tuple[str, ...] = ()
    variants: tuple[Variant, ...] = ()
    stretch: tuple[float, float] | None = None
    peak: tuple[float, float] | None = None
    findings: str = ""
    methods: tuple[str, ...] = ()
    margins: MarginPlan | None = None
    seed: int = 1
    choices: tuple[Choice, ...] = ()
    seeds: int = 0
