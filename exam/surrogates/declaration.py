"""The declaration of a surrogate flight: records, small causes with their levels, dominant effect
and the vehicle file of the loop; and the differences between the axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sim.vehicles.factory import RIGID_CONSTANTS
from sim.vehicles.uncoupled import LATERAL_CONSTANTS, Lateral

# ---- What a surrogate flight for a measured flight declares

Span = tuple[float, float]

MEASURED = ("alpha", "q", "nz")
OPTIONAL = ("theta", "airspeed", "dynamic_pressure", "ax")
LONGITUDINAL, LATERAL = "longitudinal", "lateral"


@dataclass(frozen=True)
class Causes:
    """Levels of the small causes; zero switches a cause off.

    In the lateral axis, yaw replaces pitch, the side force replaces the lift, and rudder and
    aileron replace the elevator.

    Attributes
    ----------
    anti_alias : corner of the second-order filter of every channel, inputs included, Hz.
    anti_alias_spread, anti_alias_odd : share by which the corners differ between channels, and
        share of the flights in which they do.
    input_noise : noise of the recorded elevator, rad.
    turbulence, turbulence_length : Dryden gusts, standard deviation in m/s and scale length in m.
    speed_drift : share of the airspeed that is gained or lost over a record by thrust, one sigma.
    gravity : share of the weight that bends the path and changes the speed; 1 is the true weight.
    trim_lift : share of the trim lift that depends on the speed.
    downwash, downwash_lag : derivative of the moment by alpha_dot, as a share of Cm_q, and its time
        constant, s.
    elastic : loads of a weak mode on the elevator, as a share of Cm_de and CL_de; its gyro reads
        this share times 0.1 s times the bending rate.
    moment_curvature, lift_curvature : share of the load that is lost (or gained) at 0.1 rad.
    mass_scatter, inertia_scatter, airspeed_scatter, density_scatter : scatter between records,
        shares, one sigma.
    trim_scatter : scatter of the trim angle of attack and of the elevator's zero, rad, one sigma.
    noise_std, noise_time : standard deviation of the coloured sensor noise by channel, and its
        correlation time, s.
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
    """The records of a flight, and the aircraft. Values are drawn uniformly from spans.

    Attributes
    ----------
    vehicles, variation : names to draw from, and largest relative deviation of constants and
        derivatives from those of the named vehicle.
    records : smallest and largest number of records.
    duration, step : duration of a record and integration step, s.
    rates : sample rates to draw from, 1/s.
    maneuvers, once : kinds of maneuvers, assigned in random order, and one that replaces the
        maneuver of a random record.
    amplitude : elevator, rad.
    surface : frequency of the surface's servo, rad/s, which rounds every step before it is
        recorded.
    trim_alpha : trim angle of attack, rad.
    total : whether angle of attack and load factor are recorded with their trim values.
    optional : probability of each further channel.
    unrecorded : further channels that no flight records.
    level : whether the pilot holds the height with the elevator while a hidden speed-variation
        acts; otherwise the path bends down as the lift falls.
    axis : ``LONGITUDINAL`` or ``LATERAL``.
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
    """Number, names and size of the dominant effects.

    ``reduction`` is the share of the model's error that is due to an effect, in the channel that
    shows it most. ``sizes`` has sizes by name that replace it, in the unit of `flights.kinds`.
    """

    count: int = 0
    names: tuple[str, ...] = ()
    reduction: Span = (0.45, 0.65)
    sizes: Mapping[str, Span] = field(default_factory=dict)


@dataclass(frozen=True)
class Surrogate:
    """A named study of the loop on flights that look measured.

    ``wrong`` is the largest relative error of starting values, which are drawn uniformly with
    either sign. ``draws`` is the number of flights for pseudo-true values in a campaign; zero for
    none.
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


# ---- What differs between surrogate flights of the two axes


@dataclass(frozen=True)
class Axis:
    """One axis of motion.

    Attributes
    ----------
    model : name of the model for the loop.
    inputs : inputs that move and are recorded.
    measured, optional : outputs of every record, and further ones.
    constants : constants of the vehicle file.
    scattered : constants that differ between records, each with the level of `Causes` of its
        scatter.
    """

    model: str
    inputs: tuple[str, ...]
    measured: tuple[str, ...]
    optional: tuple[str, ...]
    constants: tuple[str, ...]
    scattered: Mapping[str, str]


_AIR = {"airspeed": "airspeed_scatter", "air_density": "density_scatter"}
AXES: Mapping[str, Axis] = {
    LONGITUDINAL: Axis(
        "rigid",
        ("elevator",),
        MEASURED,
        OPTIONAL,
        tuple(RIGID_CONSTANTS),
        {"mass": "mass_scatter", "pitch_inertia": "inertia_scatter", **_AIR},
    ),
    LATERAL: Axis(
        "lateral",
        ("rudder", "aileron"),
        tuple(signal.name for signal in Lateral().outputs),
        (),
        tuple(LATERAL_CONSTANTS),
        {
            "mass": "mass_scatter",
            "roll_inertia": "inertia_scatter",
            "yaw_inertia": "inertia_scatter",
            **_AIR,
        },
    ),
}
