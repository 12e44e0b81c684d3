"""Small expressions over the columns of a record: ``0.5*(elevon_left + elevon_right)``, ``pitch(q0,
q1, q2, q3)``.

An expression is parsed into Python's syntax tree, of which only arithmetic, column names, numbers,
lists of numbers and the functions below are evaluated. Other column names are written in
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
DEEPEST_NESTING = 40
_QUOTED = re.compile(r"`([^`]+)`")
_PATH = re.compile(r"(?<![\w.`\])])([A-Za-z_]\w*(?:\[\d+\])?(?:\.[A-Za-z_]\w*(?:\[\d+\])?)*)")

Values = np.ndarray | float


@dataclass(frozen=True)
class Expression:
    """A checked expression.

    Attributes
    ----------
    text : as it was written.
    columns : the columns that it reads, by their names in the file.
    tree : its syntax tree.
    """

    text: str
    columns: tuple[str, ...]
    tree: ast.expr
    names: tuple[tuple[str, str], ...]


# name -> (arguments that are arrays, what it gives), for the documentation
FUNCTIONS: dict[str, tuple[Callable[..., Any], str]] = {}


def _function(name: str, says: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    def keep(function: Callable[..., Any]) -> Callable[..., Any]:
        FUNCTIONS[name] = function, says
        return function

    return keep


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
def _table(x: Values, at: Sequence[float], values: Sequence[float]) -> Values:
    if len(at) != len(values) or len(at) < 2 or np.any(np.diff(at) <= 0.0):
        raise ValueError("a table needs two lists of one length, the first increasing")
    result = np.interp(x, at, values)
    return np.where(np.isnan(x), np.nan, result)


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
    density = _pressure_at(height) / (287.05287 * temperature)
    return speed * np.sqrt(1.225 / density)


@_function(
    "tas_of_cas",
    "tas_of_cas(cas, height, temperature): true airspeed of a calibrated airspeed with "
    "compressibility; m/s, m, K",
)
def _tas_of_cas(cas: Values, height: Values, temperature: Values) -> Values:
    sound = 340.294
    impact = 101325.0 * ((1.0 + 0.2 * (cas / sound) ** 2) ** 3.5 - 1.0)
    mach2 = 5.0 * ((impact / _pressure_at(height) + 1.0) ** (2.0 / 7.0) - 1.0)
    return np.sqrt(mach2 * 1.4 * 287.05287 * temperature)


@_function(
    "height_of_pressure",
    "height_of_pressure(pressure): pressure height of the standard atmosphere, m, of Pa",
)
def _height_of_pressure(pressure: Values) -> Values:
    troposphere = 288.15 / 0.0065 * (1.0 - (pressure / 101325.0) ** (0.0065 * 287.05287 / G0))
    above = 11000.0 + 287.05287 * 216.65 / G0 * np.log(22632.06 / np.maximum(pressure, 1e-300))
    return np.where(pressure > 22632.06, troposphere, above)


def _pressure_at(height: Values) -> Values:
    """Pressure of the standard atmosphere, Pa, at a height in m, up to 20 km."""
    troposphere = 101325.0 * np.maximum(1.0 - 0.0065 * height / 288.15, 1e-9) ** (
        G0 / (0.0065 * 287.05287)
    )
    return np.where(
        height < 11000.0,
        troposphere,
        22632.06 * np.exp(-G0 * (height - 11000.0) / (287.05287 * 216.65)),
    )


def _to_body(
    vn: Values, ve: Values, vd: Values, phi: Values, theta: Values, psi: Values
) -> tuple[Values, Values, Values]:
    sp, cp, st = np.sin(phi), np.cos(phi), np.sin(theta)
    ct, ss, cs = np.cos(theta), np.sin(psi), np.cos(psi)
    u = ct * cs * vn + ct * ss * ve - st * vd
    v = (sp * st * cs - cp * ss) * vn + (sp * st * ss + cp * cs) * ve + sp * ct * vd
    w = (cp * st * cs + sp * ss) * vn + (cp * st * ss - sp * cs) * ve + cp * ct * vd
    return u, v, w


def parse(text: str, where: str) -> Expression:
    """Check an expression.

    Parameters
    ----------
    text : the expression.
    where : file and channel, for messages.

    Raises
    ------
    RecordError : it is too long, no arithmetic, or calls what is no function here.
    """
    if len(text) > LONGEST_EXPRESSION:
        raise RecordError(
            f"an expression of {len(text)} characters",
            where=where,
            remedy=f"write at most {LONGEST_EXPRESSION}",
        )
    names: dict[str, str] = {}

    def stand_in(column: str) -> str:
        key = next((key for key, value in names.items() if value == column), None)
        if key is None:
            key = f"_column_{len(names)}_"
            names[key] = column
        return key

    unquoted = _QUOTED.sub(lambda found: f" {stand_in(found[1])} ", text)
    called = set(FUNCTIONS)

    def path(found: re.Match[str]) -> str:
        word = found[1]
        if (
            word in names
            or (word in called and unquoted[found.end() :].lstrip().startswith("("))
            or word == "pi"
        ):
            return word
        return stand_in(word)

    unquoted = _PATH.sub(path, unquoted)
    try:
        tree = ast.parse(unquoted.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise RecordError(f"{text!r} is no expression", where=where, remedy=_REMEDY) from None
    _check(tree, text, where, names, 0)
    return Expression(text, tuple(names.values()), tree, tuple(names.items()))


def is_plain_name(text: str) -> bool:
    """Return whether a text has no operator, so that it can only be a column."""
    return re.search(r"[-+*/()`]", text) is None


def evaluate(expression: Expression, columns: Mapping[str, np.ndarray], where: str) -> np.ndarray:
    """Return the values of an expression, shape ``(N,)``, of the columns that it reads, each of
    shape ``(N,)``.

    Raises
    ------
    RecordError : it fails for these numbers, or gives something that is no column.
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


_REMEDY = f"use column names, numbers, + - * / **, and {', '.join(sorted(FUNCTIONS))}"
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: np.divide(a, b),
    ast.Pow: lambda a, b: np.power(np.asarray(a, dtype=float), b),
}


def _arguments(function: Callable[..., Any]) -> tuple[int, int]:
    """Return the least and largest number of arguments of a function of expressions."""
    if isinstance(function, np.ufunc):
        return function.nin, function.nin
    given = inspect.signature(function).parameters.values()
    return sum(each.default is each.empty for each in given), len(given)


def _check(node: ast.AST, text: str, where: str, names: Mapping[str, str], depth: int) -> None:
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
        function, says = FUNCTIONS[node.func.id]
        least, most = _arguments(function)
        if not least <= len(node.args) <= most:
            number = {1: "one value", 2: "two values", 3: "three values"}.get(
                least, f"{least} values"
            )
            raise RecordError(
                f"{node.func.id} needs {number}, not {len(node.args)}, in {text!r}",
                where=where,
                remedy=f"write {says}",
            )
        inner = list(node.args)
    elif isinstance(node, ast.List | ast.Tuple):
        inner = list(node.elts)
    else:
        raise wrong
    for each in inner:
        _check(each, text, where, names, depth + 1)


def _value(node: ast.AST, values_by_name: Mapping[str, np.ndarray]) -> Any:
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
        return FUNCTIONS[node.func.id][0](*(_value(each, values_by_name) for each in node.args))
    assert isinstance(node, ast.List | ast.Tuple)
    return [_value(each, values_by_name) for each in node.elts]
