"""The compiled model: five functions on rows of numbers, the only thing that algorithms see.

Rows: ``x``, ``u`` and ``p`` are sequences with one entry a state, input or parameter; an entry is a
float, a complex number or an array whose axes are batch axes. The same source serves the step-by-step
filter (floats), banks and campaigns (arrays of runs), whole-record fits (arrays of samples) and
derivatives (complex).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.effect import (
    Signal,
)
from sim.declaration.model import Noise
from sim.declaration.parameters import ParameterSet

Rows = Sequence[Any]


@dataclass(frozen=True, eq=False)
class System:
    """Five array functions and the names of what they take.

    ``input_path(p, u, edges)`` maps cell means of the recorded inputs to cell means at the vehicle, ``f(t, x, u, p)``
    gives the rates of the states, ``h(t, x, u, p)`` the outputs before sensors with memory,
    ``sensor_path(p, begin, end, steps)`` the outputs after them, ``noise(p)`` the spectral density of
    each state's forcing and the measurement variance of each output. ``input_stages`` and
    ``sensor_stages`` name the effects on the two paths: with none the path is the identity, bit for bit.
    ``input_parameters`` act on the input path only, ``output_parameters`` only after the dynamics: an algorithm may
    spare itself the derivatives of ``f`` by them. ``stationary`` names the states of noise effects: random ones, whose start
    is drawn from their own stationary distribution.
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

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.outputs)
