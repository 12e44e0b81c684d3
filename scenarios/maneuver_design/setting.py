"""Setting of a design: request, kinds of maneuvers, limits, and the model in trim."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.maneuver_design import PlannedManeuver
from ident.whole_record.layout import FitSettings
from scenarios.files.declarations import closest
from scenarios.files.formats.cells import number_of_text
from scenarios.files.schemas import number_in
from scenarios.files.sources import Source
from scenarios.files.user_models import OwnModel, channel_units, inputs_at_rest, is_own, unit_in
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.identification.model_checks import PULSE_LENGTH_FACTOR, doublet_motion
from scenarios.maneuver_design.limits import (
    COMPUTER,
    PILOT,
    Flyer,
    Limits,
    limits_of,
    usual_limits,
    with_usual_rates,
)
from scenarios.preparation.declared_model import (
    model_of_file,
    outputs_with_bias,
    root_sizes,
    sub_step,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.errors import DeclarationError
from sim.maneuvers import Maneuver, Spacing, Sweep, doublet, least_peak_multisine, three_two_one_one
from sim.maths import complex_step_jacobian
from sim.record import Channel, Hold, Record

# ---- Request of a design, in the words of its command line

TYPICAL, JUST_FOUND = "typical", "found"


@dataclass(frozen=True, eq=False)
class DesignRequest:
    """Request of a maneuver design. Texts are ``NAME=VALUE``, in SI or with a unit.

    Attributes
    ----------
    model, vehicle : as of ``identify``.
    limits : a TOML file, or its content.
    tell : names of effects to separate, the first from each of the others.
    size : of the first effect: ``typical``, ``found`` (barely detectable in the reference
        maneuver), or ``KEY=VALUE,...`` of its parameters.
    values : derivatives that replace those of the vehicle file.
    noise, amplitude : by output, by input.
    duration, rate : s, samples per second; None: by the model's roots or the band.
    band : Hz; sweeps and multisines in this band, compared by their frequency responses.
    computer : a flight computer moves the controls, not a pilot.
    """

    model: str | OwnModel
    vehicle: Path | Source | None = None
    limits: Path | Mapping[str, Any] | None = None
    tell: tuple[str, ...] = ()
    size: str = TYPICAL
    values: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    amplitude: tuple[str, ...] = ()
    duration: float | None = None
    rate: float | None = None
    band: tuple[float, float] | None = None
    computer: bool = False
    command_names: Mapping[str, str] = field(default_factory=dict)

    def command(self) -> str:
        """Return the command line of the request."""
        words = ["flightid", "design", "--model", self.command_names.get("model", str(self.model))]
        vehicle = self.command_names.get(
            "vehicle", str(self.vehicle) if isinstance(self.vehicle, Path) else ""
        )
        words += ["--vehicle", vehicle] if vehicle else []
        words += ["--limits", str(self.limits)] if isinstance(self.limits, Path) else []
        words += ["--tell", ",".join(self.tell)] if self.tell else []
        words += ["--size", self.size] if self.tell and self.size != TYPICAL else []
        for option, texts in (
            ("--value", self.values),
            ("--noise", self.noise),
            ("--amplitude", self.amplitude),
        ):
            words += [option, ",".join(texts)] if texts else []
        words += ["--duration", f"{self.duration:g}"] if self.duration is not None else []
        words += ["--rate", f"{self.rate:g}"] if self.rate is not None else []
        words += ["--band", *(f"{each:g}" for each in self.band)] if self.band is not None else []
        words += ["--computer"] if self.computer else []
        return shlex.join(words)

    @property
    def flown(self) -> Flyer:
        """Pilot or computer that moves the controls."""
        return COMPUTER if self.computer else PILOT


# ---- Maneuvers of equal length, as large as requested or as the limits allow

TAPER = 0.05  # tapered share of a sweep
SWEEP_START_SHARE = 0.3  # lowest frequency of a sweep over that of the roots
MOST_HARMONICS = 60  # over all inputs


@dataclass(frozen=True)
class ManeuverLimits:
    """Time and bandwidth available to maneuvers.

    Two pulses of rest at the begin and the end show the trim.

    Attributes
    ----------
    time : ``(N,)``, s.
    pulse : duration of a pulse by the eigenvalues, s.
    inputs : number of inputs.
    corners : of each input, frequency (rad/s) above which a full-amplitude sine exceeds the rate
        limit.
    band : of sweeps and multisines, rad/s.
    longest_sweep : s.
    rest : between maneuvers, s.
    """

    time: np.ndarray
    pulse: float
    inputs: int
    corners: tuple[float, ...] = ()
    band: tuple[float, float] | None = None
    longest_sweep: float = math.inf
    rest: float = 0.0

    def corner(self, one: int) -> float:
        """Return the corner of an input, rad/s; infinite if its rate is not limited."""
        return self.corners[one] if self.corners else math.inf

    def slow_enough(self, one: int, row: np.ndarray) -> np.ndarray:
        """Return a row with peak one, or less if it would exceed the rate limit."""
        row = row / np.max(np.abs(row))
        fastest = float(np.max(np.abs(np.diff(row)))) / self.interval
        return np.asarray(row * min(1.0, self.corner(one) / max(fastest, 1e-300)))

    @property
    def interval(self) -> float:
        return float(self.time[1] - self.time[0])

    @property
    def lead(self) -> float:
        return max(1.0, round(2.0 * self.pulse / self.interval)) * self.interval

    @property
    def active(self) -> float:
        """Time between the rests, s."""
        return float(self.time[-1]) - 2.0 * self.lead


# (inputs, N) with peak one; None if the maneuver with this pulse width is too long
Shapes = np.ndarray | None


def steps_in_turn(
    limits: ManeuverLimits,
    pulse_width: float,
    single: Callable[[float, float, float], Maneuver],
    units: float,
) -> Shapes:
    """Return a maneuver of ``units`` pulse widths on each input in turn, with alternating sign."""
    length, gap = units * pulse_width, max(2.0 * limits.pulse, pulse_width, limits.rest)
    out = np.zeros((limits.inputs, len(limits.time)))
    at, count = limits.lead, 0
    while at + length <= limits.lead + limits.active + 1e-9:
        sign = (-1.0) ** (count // limits.inputs)
        begin = round(at / limits.interval) * limits.interval
        out[count % limits.inputs] += np.asarray(single(sign, pulse_width, begin)(limits.time))
        at, count = begin + length + gap, count + 1
    return out if count >= limits.inputs else None


def sweeps(limits: ManeuverLimits, pulse_width: float) -> Shapes:
    """Return a logarithmic sweep on each input in turn, up to half a period of ``pulse_width``.

    Its amplitude falls with the frequency where the rate limit requires it.
    """
    each = min(limits.active / limits.inputs, limits.longest_sweep)
    low = max(2.0 * math.pi / each, SWEEP_START_SHARE * 1.5 / limits.pulse)
    high = math.pi / pulse_width
    low, high = limits.band or (low, high)
    if high < 1.5 * low:
        return None
    rows = []
    for i in range(limits.inputs):
        begin = limits.lead + i * each
        row = Sweep(1.0, low, high, each, begin, TAPER * each, Spacing.LOGARITHMIC)(limits.time)
        at = np.clip((limits.time - begin) / each, 0.0, 1.0)
        rows.append(
            limits.slow_enough(
                i, row * np.minimum(1.0, limits.corner(i) / (low * (high / low) ** at))
            )
        )
    return np.array(rows)


def multisines(limits: ManeuverLimits, pulse_width: float) -> Shapes:
    """Return orthogonal multisines on all inputs at once, up to half a period of ``pulse_width``.

    Harmonics are assigned to the inputs in turn, with phases of least peak. Harmonics that would
    exceed a rate limit are smaller, so that the inputs stay orthogonal.
    """
    samples = math.floor(limits.active / limits.interval + 1e-9)
    period = samples * limits.interval
    lowest, highest = 1, min(math.floor(period / (2.0 * pulse_width)), MOST_HARMONICS)
    if limits.band is not None:
        lowest, highest = (round(omega * period / (2.0 * math.pi)) for omega in limits.band)
        lowest = max(lowest, 1)
    if highest - lowest + 1 < 2 * limits.inputs:
        return None
    begin = round(limits.lead / limits.interval) * limits.interval
    rows = []
    for i in range(limits.inputs):
        own = range(lowest + i, highest + 1, limits.inputs)
        shares = [
            min(1.0, limits.corner(i) * period / (2.0 * math.pi * harmonic)) for harmonic in own
        ]
        equal = min(shares) == max(shares)
        row = least_peak_multisine(1.0, period, own, begin, shares=None if equal else shares)(
            limits.time
        )
        rows.append(limits.slow_enough(i, row))
    return np.array(rows)


KINDS: Mapping[str, Callable[[ManeuverLimits, float], Shapes]] = {
    "3-2-1-1": lambda room, pulse_width: steps_in_turn(room, pulse_width, three_two_one_one, 7.0),
    "doublet": lambda room, pulse_width: steps_in_turn(room, pulse_width, doublet, 2.0),
    "sweep": sweeps,
    "multisine": multisines,
}
OVER_A_BAND = ("sweep", "multisine")  # kinds that take a band
# how a table prints the pulse width: as a step (s) or as the highest frequency (Hz)
PRINTED_AS = {"3-2-1-1": "step", "doublet": "step", "sweep": "up to", "multisine": "up to"}


# ---- From the request to the setting

# Default noise standard deviations, SI and g.
INSTRUMENTS: Mapping[str, float] = {
    "alpha": 0.0012,
    "q": 0.0015,
    "nz": 0.012,
    "beta": 0.0012,
    "p": 0.0015,
    "r": 0.0015,
    "phi": 0.0015,
    "ny": 0.005,
    "airspeed": 0.2,
    "theta": 0.0015,
    "nx": 0.004,
    "ax": 0.04,
    "ay": 0.05,
    "az": 0.12,
}
NOISE_SHARE = 0.01  # user models: noise over the largest response to doublets
SAMPLE_RATE = 50.0  # samples a second
DURATION = 20.0  # s
SAMPLES_PER_PULSE = 20.0  # user models: samples in a pulse
PULSES = 40.0  # user models: pulses in a flight
SLOW_ROOT_SHARE = 0.1  # roots slower than this share of the fastest do not affect the step
PER_PERIOD = 10.0  # samples per period of the band's highest frequency
SWEEP_PERIODS = 5.0  # periods of its lowest frequency for each input
MOST_SAMPLES = 20_000  # a design simulates hundreds of flights


@dataclass(frozen=True, eq=False)
class Setting:
    """Model, limits and trim that a design uses.

    ``model``: with biases, starting in trim. ``trim_inputs``, ``still``: inputs and outputs in
    trim, by name. ``step``: of a fit, s. ``flyer``: pilot or computer.
    """

    vehicle: VehicleFile
    model: Model
    maneuver_limits: ManeuverLimits
    limits: Limits
    noise: Mapping[str, float]
    trim_inputs: Mapping[str, float]
    still: Mapping[str, float]
    step: float
    flyer: Flyer = PILOT

    @property
    def rate(self) -> float:
        return 1.0 / self.maneuver_limits.interval

    def planned(self, rows: np.ndarray, *, quick: bool = False) -> PlannedManeuver:
        """Return a flight with inputs ``(inputs, N)`` about trim; ``quick``: larger steps."""
        units = channel_units(self.model)
        names = [signal.name for signal in self.model.equations.inputs]
        inputs = [
            Channel.of(name, units[name], self.trim_inputs[name] + row)
            for name, row in zip(names, rows, strict=True)
        ]
        outputs = [
            Channel.of(name, units[name], np.full(len(self.maneuver_limits.time), self.still[name]))
            for name in self.noise
        ]
        record = Record(
            self.maneuver_limits.time,
            tuple(inputs),
            tuple(outputs),
            Hold.PREVIOUS,
            "planned maneuver",
        )
        step = (
            max(self.step, min(self.maneuver_limits.interval, 2.5 * self.step))
            if quick
            else self.step
        )
        return PlannedManeuver(
            record,
            self.model,
            tuple(self.noise),
            np.array([*self.noise.values()]),
            FitSettings(max_step=step, enough=1e-6),
        )


def setting_of(request: DesignRequest) -> Setting:
    """Read the files of a request and return the setting.

    Raises
    ------
    DeclarationError : anything wrong in the files or texts, a model without an input.
    """
    vehicle = read_vehicle(request.vehicle, request.model)
    model = model_of_file(vehicle).with_noise(Noise())
    if not model.equations.inputs:
        what = f"the {model.name} model has no input to design: its start determines its motion"
        raise DeclarationError(
            what,
            where="--model",
            remedy="vary height and speed of release with flightid run NAME --set",
        )
    model = model.with_values(
        numbers_of(
            request.values,
            {item.name: item.unit for item in model.parameters if item.free},
            "--value",
        )
    )
    model, rest = in_trim(model)
    still = _outputs_at(model, rest)
    pulse = max(PULSE_LENGTH_FACTOR / _frequency(model, rest), request.flown.shortest_step)
    _refuse_band(request)
    room = _limits_of(request, model, pulse)
    noise = _noise(request, model)
    limits = limits_of(request.limits, model, usual_limits(model, still))
    inputs = {signal.name: unit_in(model, signal.name) for signal in model.equations.inputs}
    amplitude = _positive(numbers_of(request.amplitude, inputs, "--amplitude"), "--amplitude")
    limits = replace(limits, amplitude={**limits.amplitude, **amplitude})
    limits = with_usual_rates(limits, model, request.flown)
    corners = [limits.rate.get(name, math.inf) / size for name, size in limits.amplitude.items()]
    room = replace(room, corners=tuple(corners) if np.any(np.isfinite(corners)) else ())
    biased = model.with_biases(outputs_with_bias(model, list(noise)))
    setting = Setting(vehicle, biased, room, limits, noise, rest, still, 0.01, request.flown)
    return replace(
        setting,
        step=sub_step(model, [setting.planned(np.zeros((len(rest), len(room.time)))).record], 0.01),
    )


def in_trim(model: Model) -> tuple[Model, dict[str, float]]:
    """Return the model in trim, and its inputs there.

    Perturbation models and user models stay as they are; others are trimmed in level flight by
    Newton's method. Raises DeclarationError without such a flight at the reference airspeed.
    """
    names = [signal.name for signal in model.equations.inputs]
    rest = dict(zip(names, inputs_at_rest(model), strict=True))
    if is_own(model) or not {"airspeed", "theta"} <= {
        state.name for state in model.equations.states
    }:
        return model, rest
    system, p = compile_model(model), model.parameters.values().tolist()
    states, speed = list(system.state_names), model.initial["airspeed"].value

    def rates(v: list[Any]) -> list[Any]:
        alpha, elevator, thrust = v
        x = [{"airspeed": speed, "alpha": alpha, "theta": alpha, "q": 0.0}[name] for name in states]
        result = dict(
            zip(
                states,
                system.f(
                    0.0, x, [{"elevator": elevator, "thrust": thrust}[name] for name in names], p
                ),
                strict=True,
            )
        )
        return [result["airspeed"], result["alpha"], result["q"]]

    at = np.zeros(3)
    for _ in range(30):
        step = np.linalg.lstsq(
            complex_step_jacobian(rates, at.tolist()),
            np.array(rates(at.tolist()), dtype=float),
            rcond=None,
        )[0]
        at = at - step
    if not (
        np.all(np.isfinite(at)) and np.max(np.abs(rates(at.tolist()))) < 1e-6 and abs(at[0]) < 0.6
    ):
        raise DeclarationError(
            "there is no level flight with these numbers",
            where=f"{speed:g} m/s",
            remedy="check the vehicle file",
        )
    start = model.initial.with_values({"alpha": at[0], "theta": at[0]})
    return model.with_initial(start), {"elevator": float(at[1]), "thrust": float(at[2])}


def _outputs_at(model: Model, rest: Mapping[str, float]) -> dict[str, float]:
    system = compile_model(model)
    values = system.h(
        0.0,
        system.initial.values().tolist(),
        list(rest.values()),
        system.parameters.values().tolist(),
    )
    return {
        name: float(np.real(value)) for name, value in zip(system.output_names, values, strict=True)
    }


def _frequency(model: Model, rest: Mapping[str, float]) -> float:
    """Return the geometric mean of the fast roots, rad/s; 1 if there are none."""
    sizes = root_sizes(compile_model(model), list(rest.values()))
    quick = sizes[sizes > SLOW_ROOT_SHARE * np.max(sizes, initial=0.0)]
    return float(np.exp(np.mean(np.log(quick)))) if len(quick) else 1.0


def _refuse_band(request: DesignRequest) -> None:
    """Raise DeclarationError for a wrong band, or for a band together with effects."""
    if request.band is None:
        return
    low, high = request.band
    if not (0.0 < 1.5 * low <= high and math.isfinite(high)):
        remedy = "give LOW HIGH in Hz, the higher one and a half times the lower or more"
        raise DeclarationError(f"{low:g} to {high:g} Hz is no band", where="--band", remedy=remedy)
    flyer = request.flown
    if high > flyer.fastest:
        what = f"{flyer.name} does not follow a sweep to {high:g} Hz by hand"
        remedy = f"give {flyer.fastest:g} Hz at most, or --computer for a flight computer"
        raise DeclarationError(what, where="--band", remedy=remedy)
    if SWEEP_PERIODS / low > flyer.longest_sweep:
        what = f"five periods of {low:g} Hz are longer than a sweep by hand"
        least = math.ceil(1e3 * SWEEP_PERIODS / flyer.longest_sweep) / 1e3
        remedy = f"give {least:g} Hz or more, or --computer for a flight computer"
        raise DeclarationError(what, where="--band", remedy=remedy)
    if request.tell:
        what = "maneuvers for a band are compared by responses, not by effects"
        raise DeclarationError(what, where="--band, --tell", remedy="leave one of them out")


def _limits_of(request: DesignRequest, model: Model, pulse: float) -> ManeuverLimits:
    for option, value in (("--duration", request.duration), ("--rate", request.rate)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DeclarationError(
                f"{value:g} is not above 0", where=option, remedy="give a positive number"
            )
    own = is_own(model)
    rate = request.rate or (_rounded(SAMPLES_PER_PULSE / pulse) if own else SAMPLE_RATE)
    least = pulse * (4.0 * len(model.equations.inputs) + 5.0)
    duration = request.duration or (
        math.ceil(PULSES * pulse * rate) / rate if own else max(DURATION, math.ceil(1.5 * least))
    )
    band = None
    if request.band is not None:
        low, high = request.band
        band = (2.0 * math.pi * low, 2.0 * math.pi * high)
        rate = request.rate or max(rate, _rounded(PER_PERIOD * high))
        if PER_PERIOD * high > rate * (1.0 + 1e-9):
            what = f"{rate:g} samples a second are too few for {high:g} Hz"
            raise DeclarationError(
                what, where="--rate", remedy=f"give {PER_PERIOD * high:g} or more"
            )
        needed = SWEEP_PERIODS / low * len(model.equations.inputs) + 4.0 * pulse + 2.0 / rate
        duration = request.duration or math.ceil(max(duration, needed))
        if duration < 0.8 * needed:
            what = f"{duration:g} s are too short for {low:g} Hz"
            raise DeclarationError(
                what,
                where="--duration",
                remedy=f"give {math.ceil(needed)} s, five periods for each input",
            )
    count = round(duration * rate)
    if count > MOST_SAMPLES:
        raise DeclarationError(
            f"{count} samples", where="--duration, --rate", remedy=f"ask for {MOST_SAMPLES} at most"
        )
    limits = ManeuverLimits(
        np.arange(count + 1) / rate,
        pulse,
        len(model.equations.inputs),
        band=band,
        longest_sweep=request.flown.longest_sweep,
        rest=request.flown.rest,
    )
    if count < 20 or limits.active < 4.0 * pulse * limits.inputs:
        raise DeclarationError(
            f"{duration:g} s leave no room for a maneuver",
            where="--duration",
            remedy=f"give {least:.2g} s or more",
        )
    return limits


def _noise(request: DesignRequest, model: Model) -> dict[str, float]:
    """Return the noise of the requested outputs; by default of all outputs of the model."""
    units = {signal.name: signal.unit for signal in model.equations.outputs}
    given = _positive(numbers_of(request.noise, units, "--noise"), "--noise")
    if given:
        return {name: given[name] for name in units if name in given}
    if not is_own(model):
        return {name: INSTRUMENTS[name] for name in units}
    sizes = doublet_motion(model).sizes
    result = {
        name: float(f"{NOISE_SHARE * size:.2g}")
        for name, size in zip(units, sizes, strict=True)
        if size > 0.0
    }
    if not result:
        raise DeclarationError(
            "no output moves",
            where="--noise",
            remedy="name the outputs that are measured, --noise NAME=SIZE",
        )
    return result


def numbers_of(texts: Sequence[str], units: Mapping[str, str], option: str) -> dict[str, float]:
    """Return the values of ``NAME=VALUE,...`` in SI; raise DeclarationError for another form."""
    out: dict[str, float] = {}
    for word in (piece for text in texts for piece in text.split(",") if piece.strip()):
        name, equals, value = (part.strip() for part in word.partition("="))
        where = f"{option} {word.strip()}"
        if not equals:
            raise DeclarationError(
                "this is not NAME=VALUE",
                where=where,
                remedy=f"write for example {option} {next(iter(units), 'NAME')}=0.1",
            )
        if name not in units:
            raise DeclarationError(
                f"there is no {name!r} here", where=where, remedy=closest(name, units)
            )
        out[name] = number_in(_typed(value), units[name], where)
    return out


def _typed(text: str) -> float | str:
    try:
        return number_of_text(text)
    except ValueError:
        return text


def _positive(numbers: dict[str, float], option: str) -> dict[str, float]:
    for name, value in numbers.items():
        if value <= 0.0:
            raise DeclarationError(
                f"{value:g} is not above 0",
                where=f"{option} {name}",
                remedy="give a positive number",
            )
    return numbers


def _rounded(value: float) -> float:
    """Return the next of 1, 2, 5, 10, 20 ... that is not below."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(
        decade * digit for digit in (1.0, 2.0, 5.0, 10.0) if decade * digit >= value * (1.0 - 1e-9)
    )
