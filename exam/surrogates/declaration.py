"""The declaration of a surrogate flight: records, small causes with their levels, dominant effect
and the vehicle file of the loop; what differs between the axes; the declared flights by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scenarios.files.declarations import closest
from scenarios.studies.catalogue import load_document
from sim.errors import DeclarationError
from sim.vehicles.factory import RIGID_CONSTANTS
from sim.vehicles.uncoupled import LATERAL_CONSTANTS, Lateral

# ---- What a surrogate flight for a measured flight declares

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
    stands for. ``sizes``: by name what is drawn instead, in the unit of `flights.kinds`.
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


# ---- What differs between surrogate flights of the two axes


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes
    ----------
    model : that the loop is told. inputs : that move and are recorded. measured : outputs of every
    record; optional : further ones. constants : of the vehicle file. scattered : constants that
    differ from record to record, with the level of `Causes` that says how far.
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


# ---- The surrogate flights that are declared here by name, and a user's own by the path of its

CATALOG = Path(__file__).parent / "catalog"
USUAL = "surrogate-one"


def surrogate_names() -> tuple[str, ...]:
    """Names of the declared surrogate flights, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_surrogate(name: str, changes: Sequence[str] = ()) -> Surrogate:
    """A surrogate flight by its name or the path of its TOML file, with ``"key=value"`` changes.

    Raises
    ------
    DeclarationError : there is none of that name, or a key or value in its file is wrong.
    """
    from exam.surrogates.schema import surrogate_of

    if not name.endswith(".toml") and name not in surrogate_names():
        remedy = closest(name, surrogate_names())
        raise DeclarationError(
            f"there is no surrogate flight {name!r}", where="exam", remedy=remedy
        )
    file = name if name.endswith(".toml") else str(CATALOG / f"{name}.toml")
    document, short, where = load_document(file, changes)
    return surrogate_of(document, short, where if file == name else f"{name}.toml")
