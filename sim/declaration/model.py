"""The declared model: equations, parameters with ties, effects; and the System compiled from it.

``x``, ``u`` and ``p`` are sequences with one entry for each state, input or parameter. An entry is
a float, a complex number or an array whose axes are batch axes. The same functions serve filters
(floats), banks and campaigns (arrays of runs), whole-record fits (arrays of samples) and
derivatives (complex steps).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sim.declaration.effect import (
    Effect,
    Parameter,
    ParameterSet,
    SensorMemory,
    Signal,
    constants_needed,
    full_name,
    ports_needed,
)
from sim.errors import ModelError

# ---- Ties: parameters that are linear functions of others


@dataclass(frozen=True)
class Tie:
    """A parameter that is a linear function of other parameters.

    ``name`` = ``constant`` + sum of factor times parameter over ``terms``, in SI units.
    """

    name: str
    terms: tuple[tuple[str, float], ...]
    constant: float = 0.0

    def of(self, values: Callable[[str], Any]) -> Any:
        """Return the value of the tied parameter; ``values`` maps a name to its value."""
        out: Any = self.constant
        for source, factor in self.terms:
            out = out + factor * values(source)
        return out

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the parameters on the right-hand side."""
        return tuple(source for source, _ in self.terms)

    @property
    def words(self) -> str:
        """Text of the tie, ``"Cn_da = -0.1 Cl_da + 0.002"``."""
        parts = [f"{factor:g} {source}" for source, factor in self.terms] + (
            [f"{self.constant:g}"] if self.constant else []
        )
        return f"{self.name} = {' + '.join(parts)}".replace("+ -", "- ")


def with_tied_values(parameters: ParameterSet, ties: Sequence[Tie]) -> ParameterSet:
    """Return the set with each tied parameter fixed at the value of its tie.

    Raises
    ------
    ModelError : a parameter is unknown or tied twice, a tie refers to a tied parameter, or a value
        is not finite or beyond the bounds of the tied parameter.
    """
    tied = [tie.name for tie in ties]
    for tie in ties:
        where = f"tie of {tie.name}"
        for name in (tie.name, *tie.sources):
            parameters.index(name)
        if tied.count(tie.name) > 1:
            raise ModelError("tied twice", where=where, remedy="keep one of the two")
        for source in tie.sources:
            if source in tied:
                raise ModelError(
                    f"{source} is tied itself",
                    where=where,
                    remedy="tie both to parameters that are not",
                )
        if not tie.terms or not all(
            math.isfinite(number) for number in (tie.constant, *(factor for _, factor in tie.terms))
        ):
            raise ModelError(
                "no finite numbers",
                where=where,
                remedy="give one parameter at least, with a finite factor",
            )
    given = {tie.name: float(tie.of(lambda name: parameters[name].value)) for tie in ties}
    return parameters.hold(tied).with_values(given)


# ---- A model: equations of motion on named signals, parameters, initial state, noise, effects


class Equations(Protocol):
    """Equations of motion of one kind of vehicle, written once.

    ``flow(s, p)`` returns quantities on which loads depend (air angle of attack, airspeed), after
    the disturbances have acted; ``derivatives(s, p)`` returns a rate for each state, and
    ``measurements(s, p)`` a value for each output. ``s`` has states, inputs, ports and ``time`` by
    name; ``p`` has the parameters in ``parameter_names``. A port is zero unless an effect adds to
    it.
    """

    @property
    def name(self) -> str: ...
    @property
    def states(self) -> tuple[Signal, ...]: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    @property
    def ports(self) -> tuple[Signal, ...]: ...
    @property
    def parameter_names(self) -> tuple[str, ...]: ...
    def flow(self, s: Any, p: Any) -> Mapping[str, Any]: ...
    def derivatives(self, s: Any, p: Any) -> Sequence[Any]: ...
    def measurements(self, s: Any, p: Any) -> Sequence[Any]: ...


@runtime_checkable
class Containing(Protocol):
    """Equations that contain some effects of the library, named in ``contains``.

    A search does not offer these effects.
    """

    @property
    def contains(self) -> tuple[str, ...]: ...


@runtime_checkable
class Biased(Protocol):
    """Equations that declare which outputs have sensors with a free constant bias."""

    @property
    def biased_outputs(self) -> tuple[str, ...]: ...


@runtime_checkable
class Multiplying(Protocol):
    """Equations that declare which of their parameters multiply a signal.

    ``factors`` has the units of these parameters by name. An effect may make each of them vary.
    """

    @property
    def factors(self) -> Mapping[str, str]: ...


@runtime_checkable
class DrivenByOthers(Protocol):
    """Equations with inputs that are no controls, such as an updraft, named in ``no_controls``.

    No input effect is offered for these inputs.
    """

    @property
    def no_controls(self) -> tuple[str, ...]: ...


@runtime_checkable
class KnowingBiases(Protocol):
    """Equations with priors of sensor biases: ``bias_priors`` has standard deviations by output."""

    @property
    def bias_priors(self) -> Mapping[str, float]: ...


@runtime_checkable
class OfTotals(Protocol):
    """Equations that declare whether their signals are totals or perturbations about a trim."""

    @property
    def totals(self) -> bool: ...


@dataclass(frozen=True)
class Noise:
    """Random inputs and measurement errors of a model.

    Attributes
    ----------
    measurement_std : standard deviation of the white noise on each output, in its unit.
    process_density : spectral density of white noise on a state's rate or, as a random walk, on a
        free parameter: (unit of the quantity)^2 / s.
    """

    measurement_std: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    process_density: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        for name, value in self.measurement_std.items():
            if not (value > 0 and math.isfinite(value)):
                raise ModelError(
                    f"noise standard deviation {value} is not positive",
                    where=f"output {name}",
                    remedy="give a positive number",
                )
        for name, value in self.process_density.items():
            if not (value >= 0 and math.isfinite(value)):
                raise ModelError(
                    f"process noise density {value} is negative",
                    where=name,
                    remedy="give zero or a positive number",
                )


@dataclass(frozen=True)
class Model:
    """A declared model; immutable.

    Attributes
    ----------
    equations : the base equations of motion.
    parameters : parameters of the equations, of effects (with full names), and biases.
    initial : value and prior standard deviation of the initial value of each state.
    noise : measurement and process noise.
    effects : effects in the order in which they were added.
    biases : outputs with a constant bias; each has a parameter ``bias_OUTPUT``.
    ties : parameters that are functions of others; they are held at the values of their ties.
    """

    equations: Equations
    parameters: ParameterSet
    initial: ParameterSet
    noise: Noise = Noise()
    effects: tuple[Effect, ...] = ()
    biases: tuple[str, ...] = ()
    ties: tuple[Tie, ...] = ()

    def __post_init__(self) -> None:
        for name in self.equations.parameter_names:
            if name not in self.parameters:
                raise ModelError(
                    "parameter is missing",
                    where=f"model {self.equations.name}, {name}",
                    remedy="add it to the parameter set",
                )
        for effect in self.effects:
            ports = {port.name for port in self.equations.ports}
            for needed in ports_needed(effect):
                if needed not in ports:
                    raise ModelError(
                        f"effect {effect.name} needs the port {needed!r}",
                        where=f"model {self.equations.name}",
                        remedy=f"its ports are {', '.join(sorted(ports)) or 'none'}",
                    )
            for needed in constants_needed(effect):
                if needed not in self.equations.parameter_names:
                    raise ModelError(
                        f"effect {effect.name} needs the constant {needed!r}",
                        where=f"model {self.equations.name}",
                        remedy="use it on a vehicle that declares it",
                    )

    @property
    def name(self) -> str:
        return self.equations.name

    def with_parameters(self, parameters: ParameterSet) -> Model:
        """Return the model with other parameters; tied ones keep the value of their tie."""
        return replace(
            self, parameters=with_tied_values(parameters, self.ties) if self.ties else parameters
        )

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameter values replaced, as ``with_parameters``."""
        return self.with_parameters(self.parameters.with_values(values))

    def with_noise(self, noise: Noise) -> Model:
        """Return the model with other noise."""
        return replace(self, noise=noise)

    def with_ties(self, ties: Sequence[Tie]) -> Model:
        """Return the model with some parameters tied to others, and therefore fixed.

        Raises ModelError as ``with_tied_values``.
        """
        return replace(self, parameters=with_tied_values(self.parameters, ties), ties=tuple(ties))

    def with_initial(self, initial: ParameterSet) -> Model:
        """Return the model with another initial state."""
        return replace(self, initial=initial)

    def with_effects(self, *effects: Effect) -> Model:
        """Return the model with further effects, at their starting values.

        A ``shared`` effect uses a parameter that the model already has under its full name. In this
        way several inputs may have one delay.
        """
        model = self
        for effect in effects:
            if any(present.name == effect.name for present in model.effects):
                raise ModelError(
                    f"effect {effect.name} acts already",
                    where=f"model {self.name}",
                    remedy="give the second one another number or channel",
                )
            named = (replace(item, name=full_name(effect, item.name)) for item in effect.parameters)
            shared = getattr(effect, "shared", False)
            added = tuple(item for item in named if not (shared and item.name in model.parameters))
            model = replace(
                model, effects=(*model.effects, effect), parameters=model.parameters.joined(added)
            )
        return model

    def without(self, name: str) -> Model:
        """Return the model without one effect and its parameters."""
        removed = [effect for effect in self.effects if effect.name == name]
        if not removed:
            available = ", ".join(effect.name for effect in self.effects) or "none"
            raise ModelError(
                f"there is no effect {name!r}",
                where=f"model {self.name}",
                remedy=f"it has {available}",
            )
        others = tuple(effect for effect in self.effects if effect.name != name)
        shared = {full_name(effect, item.name) for effect in others for item in effect.parameters}
        names = {full_name(removed[0], item.name) for item in removed[0].parameters} - shared
        kept = ParameterSet(tuple(item for item in self.parameters if item.name not in names))
        return replace(self, effects=others, parameters=kept)

    def with_biases(self, outputs: Sequence[str], prior_std: float = math.inf) -> Model:
        """Return the model with a free constant bias on each of the named outputs.

        ``prior_std`` is the standard deviation of its prior, unless that of the equations is
        smaller.
        """
        units = {signal.name: signal.unit for signal in self.equations.outputs}
        new = [name for name in outputs if name not in self.biases]
        for name in new:
            if name not in units:
                raise ModelError(
                    f"there is no output {name!r}",
                    where=f"model {self.name}",
                    remedy=f"its outputs are {', '.join(units)}",
                )
        priors = self.equations.bias_priors if isinstance(self.equations, KnowingBiases) else {}
        added = [
            Parameter(
                f"bias_{name}",
                0.0,
                units[name],
                prior_std=min(prior_std, priors.get(name, math.inf)),
            )
            for name in new
        ]
        return replace(self, biases=(*self.biases, *new), parameters=self.parameters.joined(added))


# ---- The compiled model

Rows = Sequence[Any]


@dataclass(frozen=True, eq=False)
class System:
    """A model as array functions, with the names and units of their arguments.

    Attributes
    ----------
    states, inputs, outputs : signals in the order of x, u and y.
    parameters, initial : parameters in the order of p, and initial states.
    declared_noise : noise of the model.
    input_stages, sensor_stages : names of the effects on the two paths. A path without effects is
        the identity, bit for bit.
    input_parameters : parameters that act on the input path only.
    output_parameters : parameters that act only after the dynamics. The derivatives of ``f`` by
        these and by ``input_parameters`` are zero.
    input_path : ``input_path(p, u, edges)`` maps cell means of recorded inputs to cell means at the
        vehicle.
    f : ``f(t, x, u, p)`` returns the rates of the states.
    h : ``h(t, x, u, p)`` returns the outputs before sensors with memory.
    sensor_path : ``sensor_path(p, begin, end, steps)`` returns the outputs after these sensors.
    noise : ``noise(p)`` returns the spectral density of each state's forcing, and the measurement
        variance of each output.
    stationary : states of noise effects, whose initial values have their stationary distribution.
    sensor_memory : ``sensor_memory(p)`` returns the sensors with memory in the order in which a
        signal passes them.
    """

    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: ParameterSet
    initial: ParameterSet
    declared_noise: Noise
    input_stages: tuple[str, ...]
    sensor_stages: tuple[str, ...]
    input_parameters: frozenset[str]
    output_parameters: frozenset[str]
    input_path: Callable[[Rows, list[Any], np.ndarray], list[Any]]
    f: Callable[[Any, Rows, Rows, Rows], list[Any]]
    h: Callable[[Any, Rows, Rows, Rows], list[Any]]
    sensor_path: Callable[[Rows, list[Any], list[Any], np.ndarray], tuple[list[Any], list[Any]]]
    noise: Callable[[Rows], tuple[list[Any], list[Any]]]
    stationary: frozenset[str] = frozenset()
    sensor_memory: Callable[[Rows], list[SensorMemory]] = field(default=lambda p: [])

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.outputs)
