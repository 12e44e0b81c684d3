"""The F-16 by its tables: coefficients, and flight by equations of its own.

Tables of B. L. Stevens and F. L. Lewis, Aircraft Control and Simulation, which reduce those of
L. T. Nguyen et al., Simulator Study of Stall/Post-Stall Characteristics of a Fighter Airplane with
Relaxed Longitudinal Static Stability, NASA TP-1538, 1979; from public transcriptions. Two misprints
of the book are put right: CYp at 45 deg and Cmq at -5 deg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from sim.record import Channel, Hold, Record

DEGREE = math.pi / 180.0
SLUG, FOOT = 1.3558179483, 0.3048
AREA, SPAN, CHORD = 300.0 * FOOT**2, 30.0 * FOOT, 11.32 * FOOT
MASS = 20500.0 * 0.45359237
IX, IY, IZ, IXZ = (value * SLUG for value in (9496.0, 55814.0, 63100.0, 982.0))
SPIN = 160.0 * SLUG  # angular momentum of the engine, kg m2/s
G = 9.80665
UNITS = {
    "airspeed": "m/s",
    **dict.fromkeys(("alpha", "beta", "phi", "theta"), "rad"),
    **dict.fromkeys(("p", "q", "r"), "rad/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s2"),
}


def _rows(text: str) -> np.ndarray:
    return np.array([[float(each) for each in row.split()] for row in text.strip().splitlines()])


# Rows: CXq CYr CYp CZq Clr Clp Cmq Cnr Cnp; columns: alpha from -10 to 45 deg every 5 deg.
DAMPING = _rows("""
-.267 -.110 .308 1.34 2.08 2.91 2.76 2.05 1.50 1.49 1.83 1.21
.882 .852 .876 .958 .962 .974 .819 .483 .590 1.21 -.493 -1.04
-.108 -.108 -.188 .110 .258 .226 .344 .362 .611 .529 .298 -.227
-8.80 -25.8 -28.9 -31.4 -31.2 -30.7 -27.7 -28.2 -29.0 -29.8 -38.3 -35.3
-.126 -.026 .063 .113 .208 .230 .319 .437 .680 .100 .447 -.330
-.360 -.359 -.443 -.420 -.383 -.375 -.329 -.294 -.230 -.210 -.120 -.100
-7.21 -5.40 -5.23 -5.26 -6.11 -6.64 -5.69 -6.00 -6.20 -6.40 -6.60 -6.00
-.380 -.363 -.378 -.386 -.370 -.453 -.550 -.582 -.595 -.637 -1.02 -.840
.061 .052 .052 -.012 -.013 -.024 .050 .150 .130 .158 .240 .150
""")
RATES = ("CXq", "CYr", "CYp", "CZq", "Clr", "Clp", "Cmq", "Cnr", "Cnp")
# Rows: elevator from -24 to 24 deg every 12 deg.
CX = _rows("""
-.099 -.081 -.081 -.063 -.025 .044 .097 .113 .145 .167 .174 .166
-.048 -.038 -.040 -.021 .016 .083 .127 .137 .162 .177 .179 .167
-.022 -.020 -.021 -.004 .032 .094 .128 .130 .154 .161 .155 .138
-.040 -.038 -.039 -.025 .006 .062 .087 .085 .100 .110 .104 .091
-.083 -.073 -.076 -.072 -.046 .012 .024 .025 .043 .053 .047 .040
""")
CM = _rows("""
.205 .168 .186 .196 .213 .251 .245 .238 .252 .231 .198 .192
.081 .077 .107 .110 .110 .141 .127 .119 .133 .108 .081 .093
-.046 -.020 -.009 -.005 -.006 .010 .006 -.001 .014 .000 -.013 .032
-.174 -.145 -.121 -.127 -.129 -.102 -.097 -.113 -.087 -.084 -.069 -.006
-.259 -.202 -.184 -.193 -.199 -.150 -.160 -.167 -.104 -.076 -.041 -.005
""")
CZ = np.array(
    [0.770, 0.241, -0.100, -0.416, -0.731, -1.053, -1.366, -1.646, -1.917, -2.120, -2.248, -2.229]
)
# Rows: sideslip from 0 to 30 deg every 5 deg; odd in sideslip.
CL = _rows("""
0 0 0 0 0 0 0 0 0 0 0 0
-.001 -.004 -.008 -.012 -.016 -.022 -.022 -.021 -.015 -.008 -.013 -.015
-.003 -.009 -.017 -.024 -.030 -.041 -.045 -.040 -.016 -.002 -.010 -.019
-.001 -.010 -.020 -.030 -.039 -.054 -.057 -.054 -.023 -.006 -.014 -.027
.000 -.010 -.022 -.034 -.047 -.060 -.069 -.067 -.033 -.036 -.035 -.035
.007 -.010 -.023 -.034 -.049 -.063 -.081 -.079 -.060 -.058 -.062 -.059
.009 -.011 -.023 -.037 -.050 -.068 -.089 -.088 -.091 -.076 -.077 -.076
""")
CN = _rows("""
0 0 0 0 0 0 0 0 0 0 0 0
.018 .019 .018 .019 .019 .018 .013 .007 .004 -.014 -.017 -.033
.038 .042 .042 .042 .043 .039 .030 .017 .004 -.035 -.047 -.057
.056 .057 .059 .058 .058 .053 .032 .012 .002 -.046 -.071 -.073
.064 .077 .076 .074 .073 .057 .029 .007 .012 -.034 -.065 -.041
.074 .086 .093 .089 .080 .062 .049 .022 .028 -.012 -.002 -.013
.079 .090 .106 .106 .096 .080 .068 .030 .064 .015 .011 -.001
""")
# Rows: sideslip from -30 to 30 deg every 10 deg; by aileron over 20 deg, rudder over 30 deg.
CL_AILERON = _rows("""
-.041 -.052 -.053 -.056 -.050 -.056 -.082 -.059 -.042 -.038 -.027 -.017
-.041 -.053 -.053 -.053 -.050 -.051 -.066 -.043 -.038 -.027 -.023 -.016
-.042 -.053 -.052 -.051 -.049 -.049 -.043 -.035 -.026 -.016 -.018 -.014
-.040 -.052 -.051 -.052 -.048 -.048 -.042 -.037 -.031 -.026 -.017 -.012
-.043 -.049 -.048 -.049 -.043 -.042 -.042 -.036 -.025 -.021 -.016 -.011
-.044 -.048 -.048 -.047 -.042 -.041 -.020 -.028 -.013 -.014 -.011 -.010
-.043 -.049 -.047 -.045 -.042 -.037 -.003 -.013 -.010 -.003 -.007 -.008
""")
CL_RUDDER = _rows("""
.005 .017 .014 .010 -.005 .009 .019 .005 .000 -.005 -.011 .008
.007 .016 .014 .014 .013 .009 .012 .005 .000 .004 .009 .007
.013 .013 .011 .012 .011 .009 .008 .005 .000 .005 .003 .005
.018 .015 .015 .014 .014 .014 .014 .015 .013 .011 .006 .001
.015 .014 .013 .013 .012 .011 .011 .010 .008 .008 .007 .003
.021 .011 .010 .011 .010 .009 .008 .010 .006 .005 .000 .001
.023 .010 .011 .011 .011 .010 .008 .010 .006 .014 .020 .000
""")
CN_AILERON = _rows("""
.001 -.027 -.017 -.013 -.012 -.016 .001 .017 .011 .017 .008 .016
.002 -.014 -.016 -.016 -.014 -.019 -.021 .002 .012 .016 .015 .011
-.006 -.008 -.006 -.006 -.005 -.008 -.005 .007 .004 .007 .006 .006
-.011 -.011 -.010 -.009 -.008 -.006 .000 .004 .007 .010 .004 .010
-.015 -.015 -.014 -.012 -.011 -.008 -.002 .002 .006 .012 .011 .011
-.024 -.010 -.004 -.002 -.001 .003 .014 .006 -.001 .004 .004 .006
-.022 .002 -.003 -.005 -.003 -.001 -.009 -.009 -.001 .003 -.002 .001
""")
CN_RUDDER = _rows("""
-.018 -.052 -.052 -.052 -.054 -.049 -.059 -.051 -.030 -.037 -.026 -.013
-.028 -.051 -.043 -.046 -.045 -.049 -.057 -.052 -.030 -.033 -.030 -.008
-.037 -.041 -.038 -.040 -.040 -.038 -.037 -.030 -.027 -.024 -.019 -.013
-.048 -.045 -.045 -.045 -.044 -.045 -.047 -.048 -.049 -.045 -.033 -.016
-.043 -.044 -.041 -.041 -.040 -.038 -.034 -.035 -.035 -.029 -.022 -.009
-.052 -.034 -.036 -.036 -.035 -.028 -.024 -.023 -.020 -.016 -.010 -.014
-.062 -.034 -.027 -.028 -.027 -.027 -.023 -.023 -.019 -.009 -.025 -.010
""")


def _share(value: float, first: float, step: float, count: int) -> tuple[int, float]:
    """Interval of an even grid and the place in it; beyond the ends the last interval goes on."""
    at = (value - first) / step
    place = min(max(math.floor(at), 0), count - 2)
    return place, at - place


def _between(table: np.ndarray, row: tuple[int, float], column: tuple[int, float]) -> float:
    (i, s), (j, t) = row, column
    low = table[i, j] + t * (table[i, j + 1] - table[i, j])
    high = table[i + 1, j] + t * (table[i + 1, j + 1] - table[i + 1, j])
    return float(low + s * (high - low))


def coefficients(
    alpha: float,
    beta: float,
    elevator: float,
    aileron: float,
    rudder: float,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> dict[str, float]:
    """CX CY CZ Cl Cm Cn about 0.35 chord; angles in rad, non-dimensional p, q, r."""
    column = _share(alpha / DEGREE, -10.0, 5.0, 12)
    by_elevator = _share(elevator / DEGREE, -24.0, 12.0, 5)
    sideslip = _share(abs(beta) / DEGREE, 0.0, 5.0, 7)
    across = _share(beta / DEGREE, -30.0, 10.0, 7)
    j, t = column
    d = dict(zip(RATES, DAMPING[:, j] + t * (DAMPING[:, j + 1] - DAMPING[:, j]), strict=True))
    p, q, r = rates
    da, dr = aileron / (20.0 * DEGREE), rudder / (30.0 * DEGREE)
    lift = CZ[j] + t * (CZ[j + 1] - CZ[j])
    side = math.copysign(1.0, beta)
    return {
        "CX": _between(CX, by_elevator, column) + d["CXq"] * q,
        "CY": -0.02 * beta / DEGREE + 0.021 * da + 0.086 * dr + d["CYr"] * r + d["CYp"] * p,
        "CZ": lift * (1.0 - beta**2) - 0.19 * elevator / (25.0 * DEGREE) + d["CZq"] * q,
        "Cl": side * _between(CL, sideslip, column)
        + _between(CL_AILERON, across, column) * da
        + _between(CL_RUDDER, across, column) * dr
        + d["Clr"] * r
        + d["Clp"] * p,
        "Cm": _between(CM, by_elevator, column) + d["Cmq"] * q,
        "Cn": side * _between(CN, sideslip, column)
        + _between(CN_AILERON, across, column) * da
        + _between(CN_RUDDER, across, column) * dr
        + d["Cnr"] * r
        + d["Cnp"] * p,
    }


def loads(
    x: np.ndarray, moved: tuple[float, float, float], density: float
) -> tuple[np.ndarray, np.ndarray]:
    """Aerodynamic force N and moment N m along body axes; ``x``: u v w p q r phi theta."""
    speed = float(np.linalg.norm(x[:3]))
    alpha, beta = math.atan2(x[2], x[0]), math.asin(x[1] / speed)
    hat = tuple(x[3:6] * np.array([SPAN, CHORD, SPAN]) / (2.0 * speed))
    c = coefficients(alpha, beta, *moved, rates=(hat[0], hat[1], hat[2]))
    pressure = 0.5 * density * speed**2 * AREA
    force = pressure * np.array([c["CX"], c["CY"], c["CZ"]])
    return force, pressure * np.array([SPAN * c["Cl"], CHORD * c["Cm"], SPAN * c["Cn"]])


def turning(rates: np.ndarray, moment: np.ndarray, spin: float = 0.0) -> np.ndarray:
    """Angular accelerations by the matrix of inertia, rad/s2."""
    inertia = np.array([[IX, 0.0, -IXZ], [0.0, IY, 0.0], [-IXZ, 0.0, IZ]])
    momentum = inertia @ rates + np.array([spin, 0.0, 0.0])
    return np.linalg.solve(inertia, moment - np.cross(rates, momentum))


def fly(
    commands: Callable[[float], tuple[float, float, float, float]],
    start: Mapping[str, float],
    duration: float,
    name: str,
    *,
    noise: Mapping[str, float],
    seed: int,
    density: float = 0.9046,
    rate: float = 25.0,
) -> Record:
    """A flight under feedback of alpha and the rates: surfaces (rad) and thrust (N) are held over
    a sample, and equations are integrated by Runge and Kutta's steps of half a sample.
    """
    x = np.zeros(8)
    x[0] = start["airspeed"] * math.cos(start["alpha"])
    x[2] = start["airspeed"] * math.sin(start["alpha"])
    x[7] = start["alpha"]
    step = 0.5 / rate
    time = np.arange(round(duration * rate) + 1) / rate
    rows: dict[str, list[float]] = {key: [] for key in (*UNITS, "elevator", "aileron", "rudder")}
    push = []

    def slope(x: np.ndarray, moved: tuple[float, float, float], thrust: float) -> np.ndarray:
        force, moment = loads(x, moved, density)
        phi, theta = x[6], x[7]
        down = G * np.array(
            [
                -math.sin(theta),
                math.cos(theta) * math.sin(phi),
                math.cos(theta) * math.cos(phi),
            ]
        )
        pushed = (force + np.array([thrust, 0.0, 0.0])) / MASS + down - np.cross(x[3:6], x[:3])
        swept = x[4] * math.sin(phi) + x[5] * math.cos(phi)
        turned = x[4] * math.cos(phi) - x[5] * math.sin(phi)
        angles = np.array([x[3] + math.tan(theta) * swept, turned])
        return np.concatenate([pushed, turning(x[3:6], moment), angles])

    for t in time.tolist():
        speed, alpha = float(np.linalg.norm(x[:3])), math.atan2(x[2], x[0])
        elevator, aileron, rudder, thrust = commands(t)
        elevator += start["elevator"] + 0.4 * (alpha - start["alpha"]) + 0.4 * x[4]
        moved = (elevator, aileron + 0.15 * x[3], rudder + 0.4 * x[5])
        force, _ = loads(x, moved, density)
        felt = (force + np.array([thrust, 0.0, 0.0])) / MASS
        values = (speed, alpha, math.asin(x[1] / speed), x[6], x[7], *x[3:6], *felt, *moved)
        for key, value in zip(rows, values, strict=True):
            rows[key].append(float(value))
        push.append(thrust)
        for _ in range(2):
            a = slope(x, moved, thrust)
            b = slope(x + 0.5 * step * a, moved, thrust)
            c = slope(x + 0.5 * step * b, moved, thrust)
            x = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + slope(x + step * c, moved, thrust))
    rng = np.random.default_rng(seed)
    outputs = tuple(
        Channel.of(
            key, unit, np.array(rows[key]) + noise.get(key, 0.0) * rng.standard_normal(len(time))
        )
        for key, unit in UNITS.items()
    )
    inputs = tuple(
        Channel.of(key, "rad", np.array(rows[key])) for key in ("elevator", "aileron", "rudder")
    )
    return Record(
        time, (*inputs, Channel.of("thrust", "N", np.array(push))), outputs, Hold.PREVIOUS, name
    )
