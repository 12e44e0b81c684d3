"""Models from the numbers of a vehicle, and their linear systems about rest or trim."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Equations, Model, Noise
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import DeclarationError
from sim.maths import complex_step_jacobian
from sim.vehicles.library import Origin, SourcedNumber, VehicleData
from sim.vehicles.other_vehicles import (
    DELAY,
    LAG,
    MULTIROTOR_DERIVATIVES,
    Ballistic,
    Multirotor,
    motor_path,
)
from sim.vehicles.uncoupled import (
    LATERAL_CONSTANTS,
    LATERAL_DERIVATIVES,
    LONGITUDINAL_CONSTANTS,
    LONGITUDINAL_DERIVATIVES,
    Lateral,
    Loes,
    Longitudinal,
    ShortPeriod,
)

# ---- From a vehicle's numbers to its Model, for built-in sets and for users' files

RIGID_CONSTANTS = {
    "mass": "kg",
    "wing_area": "m2",
    "chord": "m",
    "pitch_inertia": "kg m2",
    "airspeed": "m/s",
    "air_density": "kg/m3",
}
RIGID_DERIVATIVES = {**ShortPeriod.factors}
BALLISTIC_CONSTANTS = {
    "air_density_reference": "kg/m3",
    "density_scale_height": "m",
    "gravity": "m/s2",
}
BALLISTIC_DERIVATIVES = {**Ballistic.factors}
LOES_CONSTANTS = {"airspeed": "m/s", "gravity": "m/s2", "vane_arm": "m"}
LOES_DERIVATIVES = {**Loes.factors, "inv_tau": "1/s", "delay": "s"}
LOES_OFFSETS = {"L_0": "rad/s", "M_0": "rad/s2", "delta_0": "1/s", "nz_0": "g"}
MODE_CONSTANTS = {"omega": "rad/s", "zeta": "1", "generalized_mass": "kg m2"}
MODE_DERIVATIVES = {
    **dict.fromkeys(("CL_eta", "CL_etadot", "Cm_eta", "Cm_etadot"), "1"),
    **dict.fromkeys(("Ceta_alpha", "Ceta_q", "Ceta_de"), "1/rad"),
}
_MAY_BE_ZERO = {"zeta"}
Family = tuple[Equations, Mapping[str, str], Mapping[str, str]]
# Equations of which derivatives may be left out; these are held at zero.
WHOLE_AXES: Mapping[str, Family] = {
    "lateral": (Lateral(), LATERAL_CONSTANTS, LATERAL_DERIVATIVES),
    "longitudinal": (Longitudinal(), LONGITUDINAL_CONSTANTS, LONGITUDINAL_DERIVATIVES),
    "multirotor": (Multirotor(), {}, MULTIROTOR_DERIVATIVES),
}
# All equations by name, with the units of their constants and of their estimated parameters.
FAMILIES: Mapping[str, Family] = {
    "rigid": (ShortPeriod(), RIGID_CONSTANTS, RIGID_DERIVATIVES),
    "loes": (Loes(), {**LOES_CONSTANTS, **LOES_OFFSETS}, LOES_DERIVATIVES),
    "ballistic": (Ballistic(), BALLISTIC_CONSTANTS, BALLISTIC_DERIVATIVES),
    **WHOLE_AXES,
}
ABOVE_ZERO = {
    "mass",
    "wing_area",
    "chord",
    "span",
    "pitch_inertia",
    "roll_inertia",
    "yaw_inertia",
    "airspeed",
    "reference_airspeed",
    "air_density",
}


def rigid_model(data: VehicleData, noise: Noise | None = None) -> Model:
    """Return the rigid short period with the numbers of a set, at rest.

    Constants are held and the six derivatives free. Raises DeclarationError for a number that is
    missing or has another unit, and for a constant that is not positive.
    """
    return _model(data, ShortPeriod(), RIGID_CONSTANTS, RIGID_DERIVATIVES, noise)


def flexible_model(
    data: VehicleData, modes: int | None = None, noise: Noise | None = None
) -> Model:
    """Return the rigid short period with the first ``modes`` elastic modes of a set; None for all.

    Each mode is an effect StructuralMode. Free are the six rigid derivatives, and of each mode nine
    parameters: ``CL_eta CL_etadot Cm_eta Cm_etadot Ceta_alpha Ceta_q Ceta_de`` and its own
    ``Ceta_eta Ceta_etadot``. Frequencies, dampings, generalized masses and couplings between modes
    are held. A coupling that is missing is zero. The scale of a mode's coordinate cannot be
    estimated: hold one of its ``Ceta`` or use priors.

    Raises DeclarationError as ``rigid_model``, and for more modes than the set has.
    """
    wanted = data.modes if modes is None else modes
    if not 0 <= wanted <= data.modes:
        raise DeclarationError(
            f"{wanted} elastic modes asked for",
            where=f"vehicle {data.name}",
            remedy=f"it has {data.modes}",
        )
    numbers = tuple(range(1, wanted + 1))
    model = rigid_model(data, noise).with_effects(
        *(StructuralMode(number, numbers) for number in numbers)
    )
    given = {
        name: _checked(data, name, unit)
        for name, unit, needed in mode_units(wanted)
        if needed or name in data
    }
    missing = {name: 0.0 for name, _, _ in mode_units(wanted) if name not in given}
    free = [
        mode_parameter(local, i)
        for i in numbers
        for local in (*MODE_DERIVATIVES, f"Ceta_eta{i}", f"Ceta_etadot{i}")
    ]
    model = model.with_parameters(model.parameters.only_free([*RIGID_DERIVATIVES, *free]))
    return _with_numbers(model.with_values(missing), given)


def ballistic_model(data: VehicleData, noise: Noise | None = None) -> Model:
    """Return the falling body with the numbers of a set, which include its initial state.

    Constants are held and beta is free. Raises DeclarationError as ``rigid_model``.
    """
    return _model(data, Ballistic(), BALLISTIC_CONSTANTS, BALLISTIC_DERIVATIVES, noise)


def loes_model(data: VehicleData, noise: Noise | None = None) -> Model:
    """Return the low-order equivalent system with the numbers of a set, for whole-record fits.

    Free are the parameters in ``LOES_DERIVATIVES``; ``delay`` is that of an InputDelay on the
    stick. Constants and the constant terms ``LOES_OFFSETS`` are held. A constant term that the set
    does not have is zero. Without ``vane_arm`` the vane is at the centre of gravity. A fit also
    needs a bias on each output; ``loes_filter_model`` makes the model of the filter.

    Raises DeclarationError as ``rigid_model``, and for a negative ``inv_tau`` or ``delay``.
    """
    optional = [
        SourcedNumber(name, 0.0, unit, note="zero unless given")
        for name, unit in {"vane_arm": "m", **LOES_OFFSETS}.items()
        if name not in data
    ]
    full = replace(data, numbers=(*data.numbers, *optional))
    in_equations = {name: unit for name, unit in LOES_DERIVATIVES.items() if name != "delay"}
    model = _model(full, Loes(), {**LOES_CONSTANTS, **LOES_OFFSETS}, in_equations, noise)
    delay = _checked(data, "delay", LOES_DERIVATIVES["delay"])
    model = model.with_effects(InputDelay("stick", in_vehicle_model=True))
    model = model.with_parameters(model.parameters.with_bounds({"inv_tau": (0.0, math.inf)}))
    return _with_numbers(model, {"delay": delay})


def whole_axis_model(data: VehicleData, noise: Noise | None = None) -> Model:
    """Return a lateral, longitudinal or multirotor model with the numbers of a set.

    Constants are held, derivatives in the set are free, and other derivatives are held at zero. A
    motor time constant and a delay of a set act on all commands of a multirotor. Raises
    DeclarationError as ``rigid_model``, and for inertias that no body has.
    """
    equations, constants, derivatives = WHOLE_AXES[data.equations]
    inside = {name: unit for name, unit in derivatives.items() if name in equations.parameter_names}
    absent = [
        SourcedNumber(name, 0.0, unit, note="left out")
        for name, unit in inside.items()
        if name not in data
    ]
    model = _model(
        replace(data, numbers=(*data.numbers, *absent)), equations, constants, inside, noise
    )
    values = data.values
    if isinstance(equations, Multirotor):
        model = _with_motors(data, model)
    if (
        "cross_inertia" in values
        and values["cross_inertia"] ** 2 >= values["roll_inertia"] * values["yaw_inertia"]
    ):
        what = f"{values['cross_inertia']:g} kg m2 is too large"
        raise DeclarationError(
            what,
            where=f"vehicle {data.name}, cross_inertia",
            remedy="its square is below roll_inertia yaw_inertia",
        )
    return model.with_parameters(model.parameters.hold([number.name for number in absent]))


def _with_motors(data: VehicleData, model: Model) -> Model:
    """Return the model with the path from commands to motors of a set."""
    given = {name: _checked(data, name, "s") for name in (LAG, DELAY) if name in data}
    return _with_numbers(
        model.with_effects(*motor_path(lag=LAG in given, delay=DELAY in given)), given
    )


def _with_numbers(model: Model, numbers: Mapping[str, SourcedNumber]) -> Model:
    """Return the model with the values and sources of some numbers."""
    items = (
        replace(item, value=numbers[item.name].value, source=numbers[item.name].source)
        if item.name in numbers
        else item
        for item in model.parameters
    )
    return model.with_parameters(ParameterSet(tuple(items)))


def loes_filter_model(model: Model) -> Model:
    """Return the model of the filter with the fourteen states of eq. 11 of NASA TM-101722.

    The delay is held, ``LOES_OFFSETS`` are free, and there is no other bias. The caller has to
    declare priors, initial variances and noise of the filter.
    """
    return model.with_parameters(model.parameters.hold(["delay"]).release(LOES_OFFSETS))


def vehicle_from_values(
    name: str,
    equations: str,
    values: Mapping[str, float],
    *,
    initial: Mapping[str, float] | None = None,
    modes: int = 0,
) -> VehicleData:
    """Return a user's numbers in the form of a built-in set.

    Parameters
    ----------
    name : name of the vehicle.
    equations : name of the equations, such as ``"rigid"`` or ``"lateral"``.
    values : full name -> value, in SI units and radians.
    initial : state -> initial value; zero for other states.
    modes : number of elastic modes.

    Raises
    ------
    DeclarationError : the equations and modes have no number of a name.
    """
    if equations not in FAMILIES:
        raise DeclarationError(
            f"unknown equations {equations!r}", where=name, remedy=f"use {', '.join(FAMILIES)}"
        )
    family, constants, derivatives = FAMILIES[equations]
    units = {
        **constants,
        **derivatives,
        **{full: unit for full, unit, _ in mode_units(modes if equations == "rigid" else 0)},
    }
    state_units = {signal.name: signal.unit for signal in family.states}
    numbers = tuple(_user_number(name, key, value, units) for key, value in values.items())
    start = tuple(
        _user_number(name, key, value, state_units) for key, value in (initial or {}).items()
    )
    return VehicleData(name, name, "given by the user", equations, numbers, start, modes)


def model_from_constants(
    equations: str,
    constants: Mapping[str, float],
    derivatives: Mapping[str, float],
    *,
    modes: int = 0,
    initial: Mapping[str, float] | None = None,
) -> Model:
    """Return a Model from numbers in SI; the parameters are those of ``vehicle_from_values``."""
    data = vehicle_from_values(
        "vehicle", equations, {**constants, **derivatives}, initial=initial, modes=modes
    )
    return model_of(data)


def model_of(data: VehicleData, noise: Noise | None = None) -> Model:
    """Return the most complete model of a set: with all its elastic modes, or with the delay of a
    low-order equivalent system.
    """
    if data.equations == Ballistic().name:
        return ballistic_model(data, noise)
    if data.equations == Loes().name:
        return loes_model(data, noise)
    if data.equations in WHOLE_AXES:
        return whole_axis_model(data, noise)
    return flexible_model(data, None, noise)


def mode_parameter(local: str, number: int) -> str:
    """Return the full name of a mode's parameter: ``CL_eta`` of mode 2 is ``CL_eta2``, ``Ceta_q``
    is ``Ceta2_q``.
    """
    return StructuralMode(number, (number,)).rename(local)


def mode_units(modes: int) -> tuple[tuple[str, str, bool], ...]:
    """Return every parameter of ``modes`` elastic modes: full name, unit, and whether it is
    required; couplings between modes are optional.
    """
    out: list[tuple[str, str, bool]] = []
    for i in range(1, modes + 1):
        out += [
            (mode_parameter(local, i), unit, True)
            for local, unit in {**MODE_CONSTANTS, **MODE_DERIVATIVES}.items()
        ]
        for j in range(1, modes + 1):
            out += [(f"Ceta{i}_eta{j}", "1", False), (f"Ceta{i}_etadot{j}", "1", False)]
    return tuple(out)


def _model(
    data: VehicleData,
    equations: Equations,
    constants: Mapping[str, str],
    derivatives: Mapping[str, str],
    noise: Noise | None,
) -> Model:
    """Return the model of a set; ``constants`` (held) and ``derivatives`` (free) have units by
    name.
    """
    if data.equations != equations.name:
        raise DeclarationError(
            f"its equations are {data.equations}",
            where=f"vehicle {data.name}",
            remedy=f"use a vehicle for {equations.name}",
        )
    units = {**constants, **derivatives}
    items = [
        (_checked(data, name, units[name]), name in derivatives)
        for name in equations.parameter_names
    ]
    parameters = ParameterSet(
        tuple(Parameter(n.name, n.value, n.unit, free=free, source=n.source) for n, free in items)
    )
    start = {number.name: number for number in data.initial}
    for name in start:
        if name not in {signal.name for signal in equations.states}:
            available = ", ".join(signal.name for signal in equations.states)
            raise DeclarationError(
                f"there is no state {name}",
                where=f"vehicle {data.name}, initial",
                remedy=f"use {available}",
            )
    initial = ParameterSet(
        tuple(
            Parameter(
                s.name,
                start[s.name].value if s.name in start else 0.0,
                s.unit,
                source=start[s.name].source if s.name in start else "at rest",
            )
            for s in equations.states
        )
    )
    return Model(equations, parameters, initial, noise or Noise())


def _checked(data: VehicleData, name: str, unit: str) -> SourcedNumber:
    """Return a number of a set; raise DeclarationError for another unit or a wrong sign."""
    number = data[name]
    where = f"vehicle {data.name}, {name}"
    if number.unit != unit:
        raise DeclarationError(
            f"unit {number.unit!r}", where=where, remedy=f"give the value in {unit}"
        )
    stem = re.sub(r"\d+$", "", name)
    if name in ("inv_tau", DELAY, LAG) and number.value < 0:
        raise DeclarationError(
            f"{number.value:g} {unit} is negative",
            where=where,
            remedy="give zero or a positive number",
        )
    positive = stem in {*ABOVE_ZERO, *BALLISTIC_CONSTANTS, *BALLISTIC_DERIVATIVES, *MODE_CONSTANTS}
    if positive and not (number.value > 0 or (stem in _MAY_BE_ZERO and number.value == 0)):
        raise DeclarationError(
            f"{number.value:g} {unit} is not positive", where=where, remedy="give a positive number"
        )
    return number


def _user_number(vehicle: str, name: str, value: float, units: Mapping[str, str]) -> SourcedNumber:
    if name not in units:
        raise DeclarationError(
            f"unknown number {name}", where=f"vehicle {vehicle}", remedy=f"use {', '.join(units)}"
        )
    if not math.isfinite(value):
        raise DeclarationError(
            f"{value} is not a finite number",
            where=f"vehicle {vehicle}, {name}",
            remedy="give a finite number",
        )
    return SourcedNumber(name, float(value), units[name], origin=Origin.USER)


# ---- A model about rest or a trimmed flight as a linear system


@dataclass(frozen=True, eq=False)
class SystemMatrices:
    """Matrices of x_dot = A x + B u, y = C x + D u: ``A (n, n)``, ``B (n, r)``, ``C (m, n)``, ``D
    (m, r)``.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def linearise(
    model: Model, outputs: Sequence[str] | None = None, about: Mapping[str, float] | None = None
) -> SystemMatrices:
    """Return the matrices of a model, exact to rounding, without effects on the input and sensor
    paths.

    Parameters
    ----------
    model : the model.
    outputs : outputs in the order of y; None for all.
    about : point of linearisation: states and inputs by name in SI units, zero for those not named;
        None for the origin. The matrices are the derivatives at this point. If it is no trim, the
        rates there are ignored.

    Raises
    ------
    DeclarationError : a name in ``about`` is neither a state nor an input.
    """
    system = compile_model(model, outputs)
    p = system.parameters.values().tolist()
    point = dict(about or {})
    x0 = [float(point.pop(signal.name, 0.0)) for signal in system.states]
    u0 = [float(point.pop(signal.name, 0.0)) for signal in system.inputs]
    for name in point:
        available = ", ".join(signal.name for signal in (*system.states, *system.inputs))
        raise DeclarationError(
            f"there is no state or input {name}",
            where=f"linearising {model.equations.name}",
            remedy=f"use {available}",
        )
    return SystemMatrices(
        complex_step_jacobian(lambda x: system.f(0.0, x, u0, p), x0),
        complex_step_jacobian(lambda u: system.f(0.0, x0, u, p), u0),
        complex_step_jacobian(lambda x: system.h(0.0, x, u0, p), x0),
        complex_step_jacobian(lambda u: system.h(0.0, x0, u, p), u0),
    )


def frequency_response(system: SystemMatrices, omega: float) -> np.ndarray:
    """Return C (j omega - A)^-1 B + D at ``omega``, rad/s: ``(m, r)``, complex."""
    return (
        system.C @ np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B)
        + system.D
    )


def zero_order_hold_response(system: SystemMatrices, u: np.ndarray, step: float) -> np.ndarray:
    """Return the outputs ``(m, N)`` from rest for one input ``u (N,)``, held over intervals of
    ``step`` s; exact.
    """
    from scipy.linalg import expm

    n = len(system.A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = system.A, system.B[:, 0]
    transition = expm(block * step)
    states = np.zeros((len(u), n))
    for k in range(len(u) - 1):
        states[k + 1] = transition[:n, :n] @ states[k] + transition[:n, n] * u[k]
    return system.C @ states.T + system.D[:, :1] * u
