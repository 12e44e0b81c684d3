"""A user's own model in a scenario: its file read, the true values put in, and what an estimation takes where the scenario says nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from scenarios.files.declarations import closest
from scenarios.files.own_models import OwnModel, is_model_file, read_own_model
from scenarios.files.vehicles import MODELS, with_priors
from scenarios.studies.declaration import Estimation, Start
from scenarios.studies.scenario_file.quantities import Quantity, si
from sim.declaration.effect import ParameterSet
from sim.declaration.model import Biased, Model, Noise
from sim.errors import DeclarationError, ModelError

WIDEST = 1.0  # of a state at the start where its file gives zero, in the state's unit


def model_files(names: Iterable[str]) -> dict[str, OwnModel]:
    """The models of those names that are files, each read once. Raises DeclarationError as ``read_own_model``."""
    return {name: read_own_model(name, MODELS) for name in dict.fromkeys(names) if is_model_file(name)}


def truth_of(model: Model, values: Mapping[str, Quantity], where: str) -> Model:
    """The model with the scenario's true values of parameters and constants.

    Raises
    ------
    DeclarationError : an unknown name, a wrong unit, a value beyond its bounds; ``where`` is the key of the table.
    """
    for name in values:
        if name not in model.parameters:
            raise DeclarationError(f"there is no parameter {name!r}", where=f"{where}.{name}", remedy=closest(name, model.parameters.names))
    numbers = {name: si(value, model.parameters[name].unit, f"{where}.{name}") for name, value in values.items()}
    try:
        return model.with_values(numbers)
    except ModelError as fault:
        raise DeclarationError(f"{fault.where}: {fault.what}", where=where, remedy=fault.remedy) from None


def completed(estimation: Estimation, measured: Iterable[str]) -> Estimation:
    """An estimation of an own model with what its scenario leaves to the file: outputs that are ``measured``, starts, initial states.

    A parameter starts where the file says, with half of that as its standard deviation; a state likewise, with at least ``WIDEST`` of its unit.
    """
    model = estimation.own
    assert model is not None
    noisy = set(measured)
    free = [name for name in model.parameters.free_names if name not in estimation.held]
    prior = with_priors(model, free).parameters
    starts = {name: Start(prior[name].value, prior[name].prior_std) for name in free}
    begun = {item.name: Start(item.value, max(abs(item.value), WIDEST)) for item in model.initial}
    return replace(
        estimation,
        outputs=estimation.outputs or tuple(signal.name for signal in model.equations.outputs if signal.name in noisy),
        start={**starts, **estimation.start},
        initial={**begun, **estimation.initial},
    )


def own_declared(estimation: Estimation, noise_std: Mapping[str, float]) -> Model:
    """The model an estimator starts from: ``start`` free with its priors, ``held`` fixed, constants as the file has them.

    Raises
    ------
    DeclarationError : a parameter or state that the model does not have, one that is started and held, a value beyond its bounds.
    """
    model, place = estimation.own, f"estimation {estimation.name}"
    assert model is not None
    tables = (
        ("start", "parameter", estimation.start, model.parameters.names),
        ("held", "parameter", estimation.held, model.parameters.names),
        ("initial", "state", estimation.initial, model.initial.names),
        ("outputs", "output", estimation.outputs, [signal.name for signal in model.equations.outputs]),
        ("process_noise", "state or free parameter", estimation.process_noise, (*estimation.start, *estimation.initial)),
    )
    for key, kind, names, known in tables:
        for name in names:
            if name not in known:
                raise DeclarationError(f"there is no {kind} {name!r}", where=f"{place}, key {key}", remedy=closest(name, known))
    for name in estimation.held:
        if name in estimation.start:
            raise DeclarationError(f"{name} is under start and under held", where=f"{place}, key held", remedy="keep one of the two")
    try:
        started = model.with_values({**{name: start.value for name, start in estimation.start.items()}, **estimation.held})
    except ModelError as fault:
        raise DeclarationError(f"{fault.where}: {fault.what}", where=f"{place}, key start", remedy=fault.remedy) from None
    free = started.parameters.only_free(estimation.start).with_prior({name: start.std for name, start in estimation.start.items()})
    begun = (replace(item, value=estimation.initial[item.name].value, prior_std=estimation.initial[item.name].std) for item in model.initial)
    noise = Noise(dict(noise_std), dict(estimation.process_noise))
    return replace(started, parameters=free, initial=ParameterSet(tuple(begun)), noise=noise)


def own_biases(model: Model, outputs: Iterable[str]) -> list[str]:
    """Those of the outputs whose sensors the file gives a free constant bias."""
    told = model.equations.biased_outputs if isinstance(model.equations, Biased) else ()
    return [name for name in outputs if name in told]
