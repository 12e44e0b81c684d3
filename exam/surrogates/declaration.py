"""What a surrogate flight for a measured flight declares: records, the small causes with their
levels, what dominates, what the loop is told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Span = tuple[float, float]

MEASURED = ("alpha", "q", "nz")
OPTIONAL = ("theta", "airspeed", "dynamic_pressure", "ax")
LONGITUDINAL, LATERAL = "longitudinal", "lateral"


@dataclass(frozen=True)
class Causes:
    """Levels of the small causes; zero turns each off. In the lateral axis pitch is yaw, lift the
    side force, the elevator rudder and aileron.

    Attributes
    ----------
    anti_alias : corner of the second-order filter of every channel, the elevator's too, Hz.
    anti_alias_spread : share by which the
        corners differ from channel to channel, in a share ``anti_alias_odd`` of the flights.
    input_noise : noise of the elevator's record, rad.
    turbulence, turbulence_length : Dryden gusts, standard deviation m/s, scale m.
    speed_drift : share of the airspeed gained or lost over a record by thrust, one sigma.
    gravity : share of the weight that bends the path and changes the speed: 1 as on earth.
    trim_lift : share of the trim lift that
        grows with the speed.
    downwash : derivative of the moment by alpha_dot, as a share of Cm_q. downwash_lag : its time,
    s. elastic : loads of a weak mode on the elevator, as a share of Cm_de and CL_de; its gyro reads
    that share x 0.1 s of the bending rate. moment_curvature, lift_curvature : share of the slope's
    load that is lost (or gained) at 0.1 rad. mass_scatter, inertia_scatter, airspeed_scatter,
    density_scatter : from record to record, shares, one sigma. trim_scatter : of the trim angle of
    attack and of the elevator's zero, rad, one sigma. noise_std, noise_time : coloured sensor noise
    by channel, its correlation time, s.
    """

    anti_alias: float = 0.0
    anti_alias_spread: float = 0.0
    anti_alias_odd: float = 0.0
    input_noise: float = 0.0
    turbulence: float = 0.0
    turbulence_length: float = 300.0
    speed_drift: float = 0.0
    gravity: float = 0.0
    trim_lift: float = 0.0
    downwash: float = 0.0
    downwash_lag: float = 0.1
    elastic: float = 0.0
    moment_curvature: float = 0.0
    lift_curvature: float = 0.0
    mass_scatter: float = 0.0
    inertia_scatter: float = 0.0
    airspeed_scatter: float = 0.0
    density_scatter: float = 0.0
    trim_scatter: float = 0.0
    noise_std: Mapping[str, float] = field(default_factory=dict)
    noise_time: float = 0.05


@dataclass(frozen=True)
class FlightLine:
    """The records of a flight and what flies; spans are drawn from evenly.

    Attributes
    ----------
    vehicles : names to draw from; variation : share by which constants and derivatives differ from
    the named vehicle's. records : fewest and most. duration : s. rates : 1/s, to draw from. step :
    of the integration, s. maneuvers : kinds, dealt out in random order; ``once`` : one that a
    random record flies in the place of its own. amplitude : elevator, rad. surface : frequency of
    the surface's servo, rad/s, which rounds every step before it is recorded. trim_alpha : rad.
    total : angle of attack and load factor are recorded with their trim values. optional : chance
    of each further channel. unrecorded : further channels that no flight records. level : the pilot
    holds the height with the elevator while a hidden speed-variation
        acts; without, the path bends down as the lift goes. axis : ``LONGITUDINAL`` or ``LATERAL``.
    """

    vehicles: tuple[str, ...]
    variation: float
    records: tuple[int, int]
    duration: float
    rates: tuple[float, ...]
    maneuvers: tuple[str, ...]
    amplitude: Span
    step: float = 0.005
    surface: float = 20.0
    trim_alpha: Span = (0.0, 0.0)
    total: bool = True
    optional: float = 0.0
    unrecorded: tuple[str, ...] = ()
    level: bool = False
    once: str = ""
    axis: str = LONGITUDINAL


@dataclass(frozen=True)
class Hidden:
    """How many effects dominate, of which names, and by how much.

    ``reduction`` is the share of the error, in the channel that shows it most, that an effect
    stands for. ``sizes``: by name what is drawn instead, in the unit of `flights.sizes`.
    """

    count: int = 0
    names: tuple[str, ...] = ()
    reduction: Span = (0.45, 0.65)
    sizes: Mapping[str, Span] = field(default_factory=dict)


@dataclass(frozen=True)
class Surrogate:
    """A named study of the loop on flights that look measured. ``wrong``: share by which starting
    values are off, drawn evenly, sign at random.

    ``draws``: flights that pseudo-true values rest on in a campaign, none without them.
    """

    name: str
    title: str
    about: str
    flight: FlightLine
    causes: Causes
    hidden: Hidden
    wrong: Span = (0.05, 0.3)
    draws: int = 20
    seed: int = 1
