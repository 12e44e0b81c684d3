"""Numbers of the X-29-like aircraft as frozen data: airframe, surfaces, sensors, control law, stick, telemetry.

Convention throughout ``sim.closed_loop``: SI and radians for time, speed, alpha and q. Three things keep the unit in which the
aircraft is described, because their derivatives are per that unit: surface deflections and the command u_p in degrees, the stick
in inches (aft +), and normal acceleration in g. alpha, q, the surfaces and u_p are perturbations about trim. A positive u_p is
nose up. Surfaces stand in the order canard, symmetric flaperon, strake flap.
"""

from __future__ import annotations

from dataclasses import dataclass

SURFACE_NAMES = ("canard", "flaperon", "strake")


@dataclass(frozen=True)
class Airframe:
    """Short-period derivatives at one flight condition.

    alpha_dot = L_alpha alpha + L_q q + L_surface . surfaces,  q_dot = M_alpha alpha + M_q q + M_surface . surfaces,
    incremental nz = -(V/g) [L_alpha alpha + (L_q - 1) q + L_surface . surfaces], at the centre of gravity, positive up.

    Attributes
    ----------
    title : what this airframe is.
    airspeed, gravity, air_density : m/s, m/s2, kg/m3.
    L_alpha, L_q, M_alpha, M_q : 1/s, 1, 1/s2, 1/s.
    L_surface, M_surface : per degree of each surface, 1/s/deg and 1/s2/deg.
    """

    title: str
    airspeed: float
    gravity: float
    air_density: float
    L_alpha: float
    L_q: float
    M_alpha: float
    M_q: float
    L_surface: tuple[float, float, float]
    M_surface: tuple[float, float, float]


@dataclass(frozen=True)
class Actuator:
    """One surface: its share of the command, its servo and its ram.

    The command ``mixing * u_p`` (deg, about trim) is limited to the travel, passes a second-order servo, then a ram of first
    order whose rate is limited and which stops at the ends of the travel.

    Attributes
    ----------
    mixing : deg of surface per deg of u_p.
    trim, lower, upper : deg, absolute; the travel about trim is ``lower - trim`` to ``upper - trim``.
    rate : largest rate of the ram, deg/s.
    ram : bandwidth of the ram, rad/s.
    servo_frequency, servo_damping : rad/s and 1; both None for a surface that has a ram only.
    """

    name: str
    mixing: float
    trim: float
    lower: float
    upper: float
    rate: float
    ram: float
    servo_frequency: float | None = None
    servo_damping: float | None = None


@dataclass(frozen=True)
class Sensor:
    """A feedback sensor of second order with unit gain: ``frequency`` in rad/s, ``damping`` in 1."""

    frequency: float
    damping: float


@dataclass(frozen=True)
class ControlLaw:
    """The sampled law u_p = z^-n { -LL [Kn nz + Kq q] + Ki I [r - nz - Kqi q] }.

    q in deg/s and nz incremental in g, both from the sensors; LL = (1 + s/lead)/(1 + s/lag) and I = 1/s by Tustin's rule.

    Attributes
    ----------
    Kn, Kq, Ki, Kqi : deg/g, s, deg/g/s, g s/deg.
    lead, lag : rad/s.
    frame_rate : frames a second.
    delay_frames : n, whole frames between reading the sensors and moving the command; at least 1.
    """

    Kn: float
    Kq: float
    Ki: float
    Kqi: float
    lead: float
    lag: float
    frame_rate: float
    delay_frames: int


@dataclass(frozen=True)
class StickShaping:
    """From stick to reference: r = z^-N wp/(s + wp) { K e (1 + curvature |e|) }, e the stick beyond its break-out.

    Attributes
    ----------
    dead_band : half width w of the break-out, in; e = sign(stick) max(|stick| - w, 0).
    gain, curvature : K in g/in, and 1/in.
    delay_frames : N, frames.
    lag : wp, rad/s, by Tustin's rule.
    recorded_skew : s by which the recorded stick leads the recorded outputs, see ``fly_closed_loop``.
    """

    dead_band: float
    gain: float
    curvature: float
    delay_frames: int
    lag: float
    recorded_skew: float


@dataclass(frozen=True)
class Telemetry:
    """What is recorded: ``rate`` in 1/s, ``vane_arm`` in m ahead of the centre of gravity, noise as 1 sigma in rad, rad/s, g."""

    rate: float
    vane_arm: float
    alpha_noise: float
    q_noise: float
    nz_noise: float


@dataclass(frozen=True)
class X29:
    """One complete aircraft: an airframe with its surfaces, sensors, control law, stick and telemetry."""

    name: str
    airframe: Airframe
    surfaces: tuple[Actuator, Actuator, Actuator]
    gyro: Sensor
    accelerometer: Sensor
    law: ControlLaw
    stick: StickShaping
    telemetry: Telemetry

    @property
    def frame(self) -> float:
        """Length of one frame of the control computer, s."""
        return 1.0 / self.law.frame_rate
