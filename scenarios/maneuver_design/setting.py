"""From what is asked to what flies: the model in trim, what measures it, sample times, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.maneuver_design.planned_flight import Planned
from ident.whole_record.layout import FitSettings
from scenarios.files.declarations import closest
from scenarios.files.formats.cells import plain_number
from scenarios.files.schemas import number_in
from scenarios.files.user_models import channel_units, inputs_at_rest, is_own, unit_in
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.identification.model_checks import PULSE, doublet_motion
from scenarios.maneuver_design.asked import Asked
from scenarios.maneuver_design.kinds import Room
from scenarios.maneuver_design.limits import Limits, limits_of, usual_limits
from scenarios.preparation.declared_model import model_of_file, outputs_with_bias, root_sizes, step_for
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.errors import DeclarationError
from sim.maths import complex_step_jacobian
from sim.record import Channel, Hold, Record

# Standard deviations of usual instruments, SI and g, where nobody names any.
INSTRUMENTS: Mapping[str, float] = {
    **{"alpha": 0.0012, "q": 0.0015, "nz": 0.012, "beta": 0.0012, "p": 0.0015, "r": 0.0015, "phi": 0.0015, "ny": 0.005},
    **{"airspeed": 0.2, "theta": 0.0015, "nx": 0.004},
}
SHARE = 0.01  # of an output's largest move under doublets, of a user's own model
RATE, DURATION = 50.0, 20.0  # samples a second, s
SAMPLES, PULSES = 20.0, 40.0  # of an own model: in a pulse, and pulses in its flight
SLOW = 0.1  # of the quickest root: a slower one sets no step
PER_PERIOD, CYCLES = 10.0, 5.0  # samples of the highest frequency of a band, periods of its lowest for each input
MOST_SAMPLES = 20_000  # a design simulates hundreds of flights


@dataclass(frozen=True, eq=False)
class Setting:
    """What a design works on.

    ``model`` has its biases and starts in trim; ``rest`` are the inputs there, ``still`` the outputs, by name. ``step`` s of a fit.
    """

    vehicle: VehicleFile
    model: Model
    room: Room
    limits: Limits
    noise: Mapping[str, float]
    rest: Mapping[str, float]
    still: Mapping[str, float]
    step: float

    @property
    def rate(self) -> float:
        return 1.0 / self.room.interval

    def planned(self, rows: np.ndarray, *, quick: bool = False) -> Planned:
        """A flight of inputs ``(inputs, N)`` from rest; ``quick``: in steps that only compare maneuvers."""
        units = channel_units(self.model)
        names = [signal.name for signal in self.model.equations.inputs]
        inputs = [Channel.of(name, units[name], self.rest[name] + row) for name, row in zip(names, rows, strict=True)]
        outputs = [Channel.of(name, units[name], np.full(len(self.room.time), self.still[name])) for name in self.noise]
        record = Record(self.room.time, tuple(inputs), tuple(outputs), Hold.PREVIOUS, "planned maneuver")
        step = max(self.step, min(self.room.interval, 2.5 * self.step)) if quick else self.step
        return Planned(record, self.model, tuple(self.noise), np.array([*self.noise.values()]), FitSettings(max_step=step, enough=1e-6))


def setting_of(asked: Asked) -> Setting:
    """Read the files and put everything together.

    Raises
    ------
    DeclarationError : anything wrong in the files or texts, a model without an input, in one line.
    """
    vehicle = read_vehicle(asked.vehicle, asked.model)
    model = model_of_file(vehicle).with_noise(Noise())
    if not model.equations.inputs:
        what = f"the {model.name} model has no input to design: what it does follows from where it begins"
        raise DeclarationError(what, where="--model", remedy="vary height and speed of release with flightid run NAME --set")
    model = model.with_values(numbers_of(asked.values, {item.name: item.unit for item in model.parameters if item.free}, "--value"))
    model, rest = in_trim(model)
    still = _outputs_at(model, rest)
    pulse = PULSE / _frequency(model, rest)
    _refuse_band(asked)
    room = _room(asked, model, pulse)
    noise = _noise(asked, model)
    limits = limits_of(asked.limits, model, usual_limits(model, still))
    inputs = {signal.name: unit_in(model, signal.name) for signal in model.equations.inputs}
    amplitude = _positive(numbers_of(asked.amplitude, inputs, "--amplitude"), "--amplitude")
    limits = replace(limits, amplitude={**limits.amplitude, **amplitude})
    corners = [limits.rate.get(name, math.inf) / size for name, size in limits.amplitude.items()]
    room = replace(room, corners=tuple(corners) if np.any(np.isfinite(corners)) else ())
    biased = model.with_biases(outputs_with_bias(model, list(noise)))
    setting = Setting(vehicle, biased, room, limits, noise, rest, still, 0.01)
    return replace(setting, step=step_for(model, [setting.planned(np.zeros((len(rest), len(room.time)))).record], 0.01))


def in_trim(model: Model) -> tuple[Model, dict[str, float]]:
    """The model where it is at rest, and its inputs there: perturbations and own models as they are, totals in level flight by Newton's method.

    Raises DeclarationError where there is no level flight at the reference airspeed.
    """
    names = [signal.name for signal in model.equations.inputs]
    rest = dict(zip(names, inputs_at_rest(model), strict=True))
    if is_own(model) or not {"airspeed", "theta"} <= {state.name for state in model.equations.states}:
        return model, rest
    system, p = compile_model(model), model.parameters.values().tolist()
    states, speed = list(system.state_names), model.initial["airspeed"].value

    def rates(v: list[Any]) -> list[Any]:
        alpha, elevator, thrust = v
        x = [{"airspeed": speed, "alpha": alpha, "theta": alpha, "q": 0.0}[name] for name in states]
        found = dict(zip(states, system.f(0.0, x, [{"elevator": elevator, "thrust": thrust}[name] for name in names], p), strict=True))
        return [found["airspeed"], found["alpha"], found["q"]]

    at = np.zeros(3)
    for _ in range(30):
        step = np.linalg.lstsq(complex_step_jacobian(rates, at.tolist()), np.array(rates(at.tolist()), dtype=float), rcond=None)[0]
        at = at - step
    if not (np.all(np.isfinite(at)) and np.max(np.abs(rates(at.tolist()))) < 1e-6 and abs(at[0]) < 0.6):
        raise DeclarationError("there is no level flight with these numbers", where=f"{speed:g} m/s", remedy="check the vehicle file")
    start = model.initial.with_values({"alpha": at[0], "theta": at[0]})
    return model.with_initial(start), {"elevator": float(at[1]), "thrust": float(at[2])}


def _outputs_at(model: Model, rest: Mapping[str, float]) -> dict[str, float]:
    system = compile_model(model)
    values = system.h(0.0, system.initial.values().tolist(), list(rest.values()), system.parameters.values().tolist())
    return {name: float(np.real(value)) for name, value in zip(system.output_names, values, strict=True)}


def _frequency(model: Model, rest: Mapping[str, float]) -> float:
    """Geometric mean of the quicker roots, rad/s; one where there is none."""
    sizes = root_sizes(compile_model(model), list(rest.values()))
    quick = sizes[sizes > SLOW * np.max(sizes, initial=0.0)]
    return float(np.exp(np.mean(np.log(quick)))) if len(quick) else 1.0


def _refuse_band(asked: Asked) -> None:
    """Raise DeclarationError for a band that is none, or for effects beside it."""
    if asked.band is None:
        return
    low, high = asked.band
    if not (0.0 < 1.5 * low <= high and math.isfinite(high)):
        remedy = "give LOW HIGH in Hz, the higher one and a half times the lower or more"
        raise DeclarationError(f"{low:g} to {high:g} Hz is no band", where="--band", remedy=remedy)
    if asked.tell:
        what = "maneuvers for a band are compared by responses, not by effects"
        raise DeclarationError(what, where="--band, --tell", remedy="leave one of them out")


def _room(asked: Asked, model: Model, pulse: float) -> Room:
    for option, value in (("--duration", asked.duration), ("--rate", asked.rate)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DeclarationError(f"{value:g} is not above 0", where=option, remedy="give a positive number")
    own = is_own(model)
    rate = asked.rate or (_rounded(SAMPLES / pulse) if own else RATE)
    least = pulse * (4.0 * len(model.equations.inputs) + 5.0)
    duration = asked.duration or (math.ceil(PULSES * pulse * rate) / rate if own else max(DURATION, math.ceil(1.5 * least)))
    band = None
    if asked.band is not None:
        low, high = asked.band
        band = (2.0 * math.pi * low, 2.0 * math.pi * high)
        rate = asked.rate or max(rate, _rounded(PER_PERIOD * high))
        if PER_PERIOD * high > rate * (1.0 + 1e-9):
            what = f"{rate:g} samples a second are too few for {high:g} Hz"
            raise DeclarationError(what, where="--rate", remedy=f"give {PER_PERIOD * high:g} or more")
        needed = CYCLES / low * len(model.equations.inputs) + 4.0 * pulse + 2.0 / rate
        duration = asked.duration or math.ceil(max(duration, needed))
        if duration < 0.8 * needed:
            what = f"{duration:g} s are too short for {low:g} Hz"
            raise DeclarationError(what, where="--duration", remedy=f"give {math.ceil(needed)} s, five periods for each input")
    count = round(duration * rate)
    if count > MOST_SAMPLES:
        raise DeclarationError(f"{count} samples", where="--duration, --rate", remedy=f"ask for {MOST_SAMPLES} at most")
    room = Room(np.arange(count + 1) / rate, pulse, len(model.equations.inputs), band=band)
    if count < 20 or room.active < 4.0 * pulse * room.inputs:
        raise DeclarationError(f"{duration:g} s leave no room for a maneuver", where="--duration", remedy=f"give {least:.2g} s or more")
    return room


def _noise(asked: Asked, model: Model) -> dict[str, float]:
    """Measured outputs with their noise: those named, all that the model has where none is."""
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    given = _positive(numbers_of(asked.noise, units, "--noise"), "--noise")
    if given:
        return {name: given[name] for name in units if name in given}
    if not is_own(model):
        return {name: INSTRUMENTS[name] for name in units}
    sizes = doublet_motion(model).sizes
    found = {name: float(f"{SHARE * size:.2g}") for name, size in zip(units, sizes, strict=True) if size > 0.0}
    if not found:
        raise DeclarationError("no output moves", where="--noise", remedy="name the outputs that are measured, --noise NAME=SIZE")
    return found


def numbers_of(texts: Sequence[str], units: Mapping[str, str], option: str) -> dict[str, float]:
    """``NAME=VALUE,...`` in SI. Raises DeclarationError with the option and the word."""
    out: dict[str, float] = {}
    for word in (piece for text in texts for piece in text.split(",") if piece.strip()):
        name, equals, value = (part.strip() for part in word.partition("="))
        where = f"{option} {word.strip()}"
        if not equals:
            raise DeclarationError("this is not NAME=VALUE", where=where, remedy=f"write for example {option} {next(iter(units), 'NAME')}=0.1")
        if name not in units:
            raise DeclarationError(f"there is no {name!r} here", where=where, remedy=closest(name, units))
        out[name] = number_in(_typed(value), units[name], where)
    return out


def _typed(text: str) -> float | str:
    try:
        return plain_number(text)
    except ValueError:
        return text


def _positive(numbers: dict[str, float], option: str) -> dict[str, float]:
    for name, value in numbers.items():
        if value <= 0.0:
            raise DeclarationError(f"{value:g} is not above 0", where=f"{option} {name}", remedy="give a positive number")
    return numbers


def _rounded(value: float) -> float:
    """The next of 1, 2, 5, 10, 20 ... that is not below."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(decade * digit for digit in (1.0, 2.0, 5.0, 10.0) if decade * digit >= value * (1.0 - 1e-9))
