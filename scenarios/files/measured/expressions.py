"""Expressions over the columns of a record: ``0.5*(elevon_left + elevon_right)``, ``pitch(q0, q1,
q2, q3)``.

An expression is parsed to a syntax tree of Python. It may have arithmetic, column names, numbers,
lists of numbers and the functions below. A column name that is no name in Python is written in
backquotes: ``rad(`AoA left`)``.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import RecordError
from sim.maths import G0

LONGEST_EXPRESSION = 500  # characters
DEEPEST_NESTING = 40  # levels of the syntax tree
# standard atmosphere
GAS_CONSTANT = 287.05287  # J/(kg K)
SEA_LEVEL_PRESSURE = 101325.0  # Pa
SEA_LEVEL_DENSITY = 1.225  # kg/m3
SEA_LEVEL_TEMPERATURE = 288.15  # K
SEA_LEVEL_SPEED_OF_SOUND = 340.294  # m/s
LAPSE_RATE = 0.0065  # K/m
TROPOPAUSE = 11000.0  # m
TROPOPAUSE_PRESSURE = 22632.06  # Pa
TROPOPAUSE_TEMPERATURE = 216.65  # K
_QUOTED = re.compile(r"`([^`]+)`")
# a column name with topic and indices, as in IMU[0].GyrY
_PATH = re.compile(r"(?<![\w.`\])])([A-Za-z_]\w*(?:\[\d+\])?(?:\.[A-Za-z_]\w*(?:\[\d+\])?)*)")

Values = np.ndarray | float


@dataclass(frozen=True)
class Expression:
    """A checked expression.

    Attributes
    ----------
    text : the expression in the file.
    columns : names of its columns in the file.
    tree : syntax tree.
    names : pairs of a name in the tree and the name of the column in the file.
    """

    text: str
    columns: tuple[str, ...]
    tree: ast.expr
    names: tuple[tuple[str, str], ...]


# name -> function of expressions, and a description of its call
FUNCTIONS: dict[str, tuple[Callable[..., Any], str]] = {}


def _function(name: str, description: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that makes a function available in expressions."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        FUNCTIONS[name] = function, description
        return function

    return add


for _name, _ufunc in {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
}.items():
    FUNCTIONS[_name] = (_ufunc, f"{_name}(x), x in rad")
FUNCTIONS |= {
    "atan2": (np.arctan2, "atan2(y, x), rad"),
    "sqrt": (np.sqrt, "sqrt(x)"),
    "abs": (np.abs, "abs(x)"),
    "exp": (np.exp, "exp(x)"),
    "log": (np.log, "log(x), natural"),
    "hypot": (np.hypot, "hypot(x, y)"),
    "min": (np.minimum, "min(x, y)"),
    "max": (np.maximum, "max(x, y)"),
    "clip": (np.clip, "clip(x, least, most)"),
    "rad": (np.radians, "rad(degrees)"),
    "deg": (np.degrees, "deg(radians)"),
    "unwrap": (np.unwrap, "unwrap(angle): jumps by a turn removed, rad"),
}


@_function(
    "pwm",
    "pwm(pulse, centre, per_radian): servo pulse to an angle, rad: (pulse - centre) / per_radian",
)
def _pwm(pulse: Values, centre: float, per_radian: float) -> Values:
    return (pulse - centre) / per_radian


@_function(
    "table",
    "table(x, [x1, x2, ...], [y1, y2, ...]): linear between the points, constant beyond them",
)
def _table(x: Values, points: Sequence[float], values: Sequence[float]) -> Values:
    if len(points) != len(values) or len(points) < 2 or np.any(np.diff(points) <= 0.0):
        raise ValueError("a table needs two lists of one length, the first increasing")
    return np.where(np.isnan(x), np.nan, np.interp(x, points, values))


@_function(
    "roll", "roll(q0, q1, q2, q3): Euler angle phi of a quaternion (scalar first, NED to body), rad"
)
def _roll(w: Values, x: Values, y: Values, z: Values) -> Values:
    return np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))


@_function("pitch", "pitch(q0, q1, q2, q3): Euler angle theta of a quaternion, rad")
def _pitch(w: Values, x: Values, y: Values, z: Values) -> Values:
    return np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))


@_function("yaw", "yaw(q0, q1, q2, q3): Euler angle psi of a quaternion, rad")
def _yaw(w: Values, x: Values, y: Values, z: Values) -> Values:
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@_function(
    "body_u",
    "body_u(vn, ve, vd, phi, theta, psi): velocity along the body's x axis, from NED velocity and "
    "attitude in rad",
)
def _body_u(vn: Values, ve: Values, vd: Values, phi: Values, theta: Values, psi: Values) -> Values:
    return _to_body(vn, ve, vd, phi, theta, psi)[0]


@_function("body_v", "body_v(vn, ve, vd, phi, theta, psi): along the y axis (right)")
def _body_v(vn: Values, ve: Values, vd: Values, phi: Values, theta: Values, psi: Values) -> Values:
    return _to_body(vn, ve, vd, phi, theta, psi)[1]


@_function("body_w", "body_w(vn, ve, vd, phi, theta, psi): along the z axis (down)")
def _body_w(vn: Values, ve: Values, vd: Values, phi: Values, theta: Values, psi: Values) -> Values:
    return _to_body(vn, ve, vd, phi, theta, psi)[2]


@_function(
    "alpha_of", "alpha_of(u, w): angle of attack of the body velocity relative to the air, rad"
)
def _alpha_of(u: Values, w: Values) -> Values:
    return np.arctan2(w, u)


@_function("beta_of", "beta_of(u, v, w): angle of sideslip, rad")
def _beta_of(u: Values, v: Values, w: Values) -> Values:
    return np.arcsin(np.clip(v / np.maximum(np.sqrt(u * u + v * v + w * w), 1e-9), -1.0, 1.0))


@_function(
    "tas_of_ias",
    "tas_of_ias(speed, height, temperature): true airspeed of an indicated airspeed at low speed; "
    "m, K",
)
def _tas_of_ias(speed: Values, height: Values, temperature: Values) -> Values:
    density = _pressure_at(height) / (GAS_CONSTANT * temperature)
    return speed * np.sqrt(SEA_LEVEL_DENSITY / density)


@_function(
    "tas_of_cas",
    "tas_of_cas(cas, height, temperature): true airspeed of a calibrated airspeed with "
    "compressibility; m/s, m, K",
)
def _tas_of_cas(cas: Values, height: Values, temperature: Values) -> Values:
    impact_ratio = (1.0 + 0.2 * (cas / SEA_LEVEL_SPEED_OF_SOUND) ** 2) ** 3.5 - 1.0
    impact_pressure = SEA_LEVEL_PRESSURE * impact_ratio
    mach_squared = 5.0 * ((impact_pressure / _pressure_at(height) + 1.0) ** (2.0 / 7.0) - 1.0)
    return np.sqrt(mach_squared * 1.4 * GAS_CONSTANT * temperature)


@_function(
    "height_of_pressure",
    "height_of_pressure(pressure): pressure height of the standard atmosphere, m, of Pa",
)
def _height_of_pressure(pressure: Values) -> Values:
    exponent = LAPSE_RATE * GAS_CONSTANT / G0
    below_tropopause = (
        SEA_LEVEL_TEMPERATURE / LAPSE_RATE * (1.0 - (pressure / SEA_LEVEL_PRESSURE) ** exponent)
    )
    log_ratio = np.log(TROPOPAUSE_PRESSURE / np.maximum(pressure, 1e-300))
    above_tropopause = TROPOPAUSE + GAS_CONSTANT * TROPOPAUSE_TEMPERATURE / G0 * log_ratio
    return np.where(pressure > TROPOPAUSE_PRESSURE, below_tropopause, above_tropopause)


def _pressure_at(height: Values) -> Values:
    """Return the pressure of the standard atmosphere, Pa, at a height, m, up to 20 km."""
    temperature_ratio = np.maximum(1.0 - LAPSE_RATE * height / SEA_LEVEL_TEMPERATURE, 1e-9)
    below_tropopause = SEA_LEVEL_PRESSURE * temperature_ratio ** (G0 / (LAPSE_RATE * GAS_CONSTANT))
    above_tropopause = TROPOPAUSE_PRESSURE * np.exp(
        -G0 * (height - TROPOPAUSE) / (GAS_CONSTANT * TROPOPAUSE_TEMPERATURE)
    )
    return np.where(height < TROPOPAUSE, below_tropopause, above_tropopause)


def _to_body(
    vn: Values, ve: Values, vd: Values, phi: Values, theta: Values, psi: Values
) -> tuple[Values, Values, Values]:
    """Return a velocity along the body axes from its components along north, east and down."""
    sp, cp, st = np.sin(phi), np.cos(phi), np.sin(theta)
    ct, ss, cs = np.cos(theta), np.sin(psi), np.cos(psi)
    u = ct * cs * vn + ct * ss * ve - st * vd
    v = (sp * st * cs - cp * ss) * vn + (sp * st * ss + cp * cs) * ve + sp * ct * vd
    w = (cp * st * cs + sp * ss) * vn + (cp * st * ss - sp * cs) * ve + cp * ct * vd
    return u, v, w


def parse(text: str, where: str) -> Expression:
    """Return the expression of a text.

    Parameters
    ----------
    text : the expression in the file.
    where : file and channel, for messages.

    Raises
    ------
    RecordError : if the text is too long, is no arithmetic, or calls an unknown function.
    """
    if len(text) > LONGEST_EXPRESSION:
        raise RecordError(
            f"an expression of {len(text)} characters",
            where=where,
            remedy=f"write at most {LONGEST_EXPRESSION}",
        )
    names: dict[str, str] = {}  # name in the tree -> column

    def name_of(column: str) -> str:
        """Return the name of a column in the tree."""
        name = next((name for name, known in names.items() if known == column), None)
        if name is None:
            name = f"_column_{len(names)}_"
            names[name] = column
        return name

    unquoted = _QUOTED.sub(lambda match: f" {name_of(match[1])} ", text)

    def replacement(match: re.Match[str]) -> str:
        """Return the name in the tree, unless the word is a function, pi, or such a name."""
        word = match[1]
        is_call = word in FUNCTIONS and unquoted[match.end() :].lstrip().startswith("(")
        return word if word in names or is_call or word == "pi" else name_of(word)

    unquoted = _PATH.sub(replacement, unquoted)
    try:
        tree = ast.parse(unquoted.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise RecordError(f"{text!r} is no expression", where=where, remedy=_REMEDY) from None
    _check(tree, text, where, names, 0)
    return Expression(text, tuple(names.values()), tree, tuple(names.items()))


def is_plain_name(text: str) -> bool:
    """Return whether a text has no operator, so that it is the name of a column."""
    return re.search(r"[-+*/()`]", text) is None


def evaluate(expression: Expression, columns: Mapping[str, np.ndarray], where: str) -> np.ndarray:
    """Return the values ``(N,)`` of an expression.

    Parameters
    ----------
    columns : column -> ``(N,)`` values, for all columns of the expression.
    where : file and channel, for messages.

    Raises
    ------
    RecordError : if it cannot be computed with these numbers, or its result is no column.
    """
    values_by_name = {key: columns[column] for key, column in expression.names}
    try:
        with np.errstate(all="ignore"):
            values = _value(expression.tree, values_by_name)
    except (ValueError, TypeError, ZeroDivisionError, OverflowError) as error:
        raise RecordError(
            f"{expression.text!r} cannot be computed ({error})", where=where, remedy=_REMEDY
        ) from None
    length = next((column.size for column in columns.values()), 1)
    return np.array(np.broadcast_to(np.asarray(values, dtype=float), (length,)))


_REMEDY = (
    "use column names (between backquotes where they hold blanks), numbers, + - * / **, and "
    f"{', '.join(sorted(FUNCTIONS))}"
)
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: np.divide(a, b),
    ast.Pow: lambda a, b: np.power(np.asarray(a, dtype=float), b),
}


def _arguments(function: Callable[..., Any]) -> tuple[int, int]:
    """Return the smallest and largest number of arguments of a function of expressions."""
    if isinstance(function, np.ufunc):
        return function.nin, function.nin
    parameters = inspect.signature(function).parameters.values()
    required = sum(parameter.default is parameter.empty for parameter in parameters)
    return required, len(parameters)


def _check(node: ast.AST, text: str, where: str, names: Mapping[str, str], depth: int) -> None:
    """Raise RecordError unless a node of the tree, with all nodes below it, is allowed.

    ``names`` are the names in the tree, and ``depth`` is the level of the node.
    """
    wrong = RecordError(f"{text!r} has more in it than arithmetic", where=where, remedy=_REMEDY)
    if depth > DEEPEST_NESTING:
        raise wrong
    inner: list[ast.AST] = []
    if isinstance(node, ast.Constant):
        if (
            isinstance(node.value, bool)
            or not isinstance(node.value, int | float)
            or not math.isfinite(node.value)
        ):
            raise wrong
    elif isinstance(node, ast.Name):
        if node.id not in names and node.id != "pi":
            raise wrong
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = [node.operand]
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        inner = [node.left, node.right]
    elif (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in FUNCTIONS
        and not node.keywords
    ):
        function, description = FUNCTIONS[node.func.id]
        least, most = _arguments(function)
        if not least <= len(node.args) <= most:
            number = {1: "one value", 2: "two values", 3: "three values"}.get(
                least, f"{least} values"
            )
            raise RecordError(
                f"{node.func.id} needs {number}, not {len(node.args)}, in {text!r}",
                where=where,
                remedy=f"write {description}",
            )
        inner = list(node.args)
    elif isinstance(node, ast.List | ast.Tuple):
        inner = list(node.elts)
    else:
        raise wrong
    for inner_node in inner:
        _check(inner_node, text, where, names, depth + 1)


def _value(node: ast.AST, values_by_name: Mapping[str, np.ndarray]) -> Any:
    """Return the value of a node of the tree."""
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        return math.pi if node.id == "pi" else values_by_name[node.id]
    if isinstance(node, ast.UnaryOp):
        value = _value(node.operand, values_by_name)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](
            _value(node.left, values_by_name), _value(node.right, values_by_name)
        )
    if isinstance(node, ast.Call):
        assert isinstance(node.func, ast.Name)
        function, _ = FUNCTIONS[node.func.id]
        return function(*(_value(argument, values_by_name) for argument in node.args))
    assert isinstance(node, ast.List | ast.Tuple)
    return [_value(element, values_by_name) for element in node.elts]
