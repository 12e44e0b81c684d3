"""Can what is hidden be seen in the record that is fitted? An effect below the noise, or within
reach of the parameters, is no question.

Its strength is the expected gain of the log likelihood: half the squared change that taking it away
makes to the outputs, in noise sigmas, as far as no change of the declared parameters, of the
initial state, of biases, or of the size of what else is hidden can stand in for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from exam.hidden_terms.library import find_any_term
from exam.random_cases.case import Case
from exam.random_cases.flying import STEP, Values, simulated
from exam.random_cases.kinds import KINDS
from exam.random_cases.vehicles import NOISE, Flight, estimated
from sim.declaration.effect import NoiseEffect
from sim.errors import ModelError

LEAST = 40.0  # log likelihood: at that strength the weak effects of ``detection`` are all detected
COARSE = 4.0 * STEP  # s
SLOPE = 1e-3  # of a parameter's or a state's value
LEAST_STATE = 0.1  # rad, rad/s: of a state that begins with zero


def all_visible(case: Case, values: Values, flight: Flight) -> bool:
    """Whether each effect that is hidden in a record can be seen there; what is random or the
    recorder's is not asked.
    """
    asked = [name for name in values if _is_smooth(name, flight)]
    if not asked:
        return True
    true = _whitened(case, values, flight, {})
    model = flight.setting.model
    columns = [np.kron(np.eye(len(true)), np.ones((true.shape[1], 1)))]
    for name in estimated(case.model):
        change = SLOPE * model.parameters[name].value
        columns.append(
            (
                _whitened(case, values, flight, {name: model.parameters[name].value + change})
                - true
            ).reshape(-1, 1)
            / SLOPE
        )
    for item in model.initial:
        moved = model.with_initial(
            model.initial.with_values(
                {item.name: item.value + SLOPE * max(abs(item.value), LEAST_STATE)}
            )
        )
        elsewhere = replace(flight, setting=replace(flight.setting, model=moved))
        there = _whitened(case, values, elsewhere, {})
        if there.shape == true.shape:
            columns.append((there - true).reshape(-1, 1) / SLOPE)
    without = {
        name: _whitened(case, {k: v for k, v in values.items() if k != name}, flight, {})
        for name in asked
    }
    if any(there.shape != true.shape for there in without.values()):
        return False  # it cannot be flown with all of them, or without one
    gone = {name: (there - true).reshape(-1, 1) for name, there in without.items()}
    return all(
        _left([*columns, *(other for key, other in gone.items() if key != name)], gone[name])
        > LEAST
        for name in asked
    )


def _left(columns: list[np.ndarray], change: np.ndarray) -> float:
    """Half the square of what the columns leave of a change."""
    basis = np.concatenate(columns, axis=1)
    basis = basis / (np.linalg.norm(basis, axis=0) + 1e-300)
    rest = change - basis @ np.linalg.lstsq(basis, change, rcond=1e-9)[0]
    return 0.5 * float(np.sum(rest**2))


def _is_smooth(name: str, flight: Flight) -> bool:
    """Whether a kind acts in the flight, and not at random: spikes and turbulence are seen by
    themselves or not at all.
    """
    kind = KINDS[name]
    if not kind.term or "spikes" in kind.term:
        return False
    return not isinstance(
        find_any_term(kind.term, flight.setting.model.equations, name), NoiseEffect
    )


def _whitened(case: Case, values: Values, flight: Flight, changed: dict[str, float]) -> np.ndarray:
    """Outputs without noise in its sigmas, ``(channels, N)``, of the aircraft with some parameters
    changed; zeros where it cannot be flown.
    """
    smooth = {name: drawn for name, drawn in values.items() if _is_smooth(name, flight)}
    try:
        record = simulated(case, smooth, flight, np.random.default_rng(0), changed, step=COARSE)
    except ModelError:
        return np.zeros((len(case.channels), 1))
    return np.stack([channel.values / NOISE[channel.name] for channel in record.outputs])
