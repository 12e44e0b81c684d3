"""Simulation of the sampled closed loop with limits and break-out, from stick to telemetry.

Frames near a limit are stepped one by one by ``sim.closed_loop.equations``, which is exact there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.equations import (
    ALL_FREE,
    Matrices,
    RamMode,
    Stepper,
    advance,
    law_matrices,
    mixing,
    plant,
    prepare,
    shape_stick,
    shaping_matrices,
)
from sim.errors import ModelError
from sim.record import Channel, Record

# ---- Pilot's stick inputs as functions of time

# Rounding of a time that is a sum of frames must not move a switch to the next frame.
_TIME_SLACK = 1e-9


@dataclass(frozen=True)
class SteppedStick:
    """Constant between switches: ``levels[i]`` (in) from ``times[i]`` (s) on, 0 before the first.

    Called with times, any shape, it returns the stick there; at a switch the new level holds.
    Raises ModelError when times and levels differ in number or the times do not increase.
    """

    times: tuple[float, ...]
    levels: tuple[float, ...]

    def __post_init__(self) -> None:
        _check(self.times, self.levels)

    def __call__(self, time: np.ndarray) -> np.ndarray:
        steps = np.searchsorted(self.times, np.asarray(time) + _TIME_SLACK, side="right")
        return np.concatenate([[0.0], self.levels])[steps]


@dataclass(frozen=True)
class SmoothStick:
    """A stepped stick through a critically damped second-order hand, bandwidth w (rad/s), in closed
    form.

    Each change d of level at t_i adds d [1 - (1 + w s) exp(-w s)] with s = t - t_i > 0. Errors as
    for SteppedStick.
    """

    times: tuple[float, ...]
    levels: tuple[float, ...]
    bandwidth: float

    def __post_init__(self) -> None:
        _check(self.times, self.levels)
        if not self.bandwidth > 0:
            raise ModelError(
                f"bandwidth {self.bandwidth:g} rad/s", where="stick", remedy="give a positive one"
            )

    def __call__(self, time: np.ndarray) -> np.ndarray:
        since = np.maximum(np.asarray(time)[..., None] - np.array(self.times), 0.0) * self.bandwidth
        changes = np.diff(np.concatenate([[0.0], self.levels]))
        return np.asarray((1.0 - (1.0 + since) * np.exp(-since)) @ changes)


def three_two_one_one(
    amplitude: float = 1.0, unit: float = 0.5, start: float = 1.0
) -> SteppedStick:
    """Return the 3-2-1-1: +, -, +, - for 3, 2, 1 and 1 units (s) from ``start`` (s), then 0; a
    negative amplitude (in) reverses the signs.
    """
    return alternating((3.0, 2.0, 1.0, 1.0), amplitude, unit, start)


def doublet(amplitude: float = 1.0, unit: float = 1.0, start: float = 1.0) -> SteppedStick:
    """Return ``unit`` s of + ``amplitude`` (in), ``unit`` s of - ``amplitude``, then 0."""
    return alternating((1.0, 1.0), amplitude, unit, start)


def alternating(
    lengths: tuple[float, ...], amplitude: float, unit: float, start: float
) -> SteppedStick:
    """Return the steps of alternating sign, ``lengths`` in units (s), then 0; switches at ``start +
    unit * sum(lengths so far)``.
    """
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    levels = [amplitude * (-1.0) ** i for i in range(len(lengths))]
    return SteppedStick(tuple(float(start + unit * edge) for edge in edges), (*levels, 0.0))


def manual_stick(
    rng: np.random.Generator,
    duration: float,
    amplitude: float = 1.0,
    bandwidth: float = 10.0,
    start: float = 0.5,
) -> SmoothStick:
    """Return a random history similar to a pilot's: pulls and pushes of different size and length,
    with rests near zero.

    Levels change every 0.3 to 1.5 s and alternate in sign with sizes of 0.3 to 1 ``amplitude``
    (in); one in four is a rest within 0.1 ``amplitude`` of zero. The stick is at 0 in the last
    second before ``duration`` (s). The same generator state gives the same history.
    """
    times, levels, sign, now = [], [], 1.0 if rng.random() < 0.5 else -1.0, start
    while now < duration - 1.0:
        resting, size, length = rng.random() < 0.25, rng.random(), rng.random()
        times.append(now)
        levels.append(
            amplitude * (0.1 * (2.0 * size - 1.0) if resting else sign * (0.3 + 0.7 * size))
        )
        sign = sign if resting else -sign
        now += 0.3 + 1.2 * length
    end = max(duration - 1.0, start)
    return SmoothStick((*times, end), (*levels, 0.0), bandwidth)


def _check(times: tuple[float, ...], levels: tuple[float, ...]) -> None:
    if len(times) != len(levels) or not times:
        raise ModelError(
            f"{len(times)} times and {len(levels)} levels",
            where="stick",
            remedy="give as many of one as of the other, at least one",
        )
    if (
        not np.all(np.isfinite(times))
        or not np.all(np.isfinite(levels))
        or np.any(np.diff(times) <= 0)
    ):
        raise ModelError(
            "times do not increase, or a number is not finite",
            where="stick",
            remedy="give finite levels at increasing times",
        )


# ---- Frames of the computer in which nothing is limited

FRAMES_PER_BLOCK = 32  # larger blocks cost more for each frame, smaller ones more calls
LIMIT_SHARE = 1.0 - 1e-9  # share of a limit below which rounding has no effect


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """``FRAMES_PER_BLOCK`` steps of ``w' = A w + b r`` at once.

    Attributes
    ----------
    from_start : ``((FRAMES_PER_BLOCK + 1) d, d)``, w at every frame from w at the first.
    from_input : ``((FRAMES_PER_BLOCK + 1) d, FRAMES_PER_BLOCK)``, from r.
    """

    from_start: np.ndarray
    from_input: np.ndarray

    def states(self, start: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Return w at the frames of ``driven (k,)``, at most ``FRAMES_PER_BLOCK``, and at the one
        after the last: ``(k + 1, d)``.
        """
        d, k = start.size, driven.size
        rows = (k + 1) * d
        return np.asarray(
            self.from_start[:rows] @ start + self.from_input[:rows, :k] @ driven
        ).reshape(k + 1, d)


def stretch(A: np.ndarray, b: np.ndarray) -> FrameBlock:
    """Return the block of frames of w' = A w + b r with ``A (d, d)`` and ``b (d,)``."""
    d = b.size
    powers, pulses = (
        np.empty((FRAMES_PER_BLOCK + 1, d, d)),
        np.zeros((FRAMES_PER_BLOCK + 1, d, FRAMES_PER_BLOCK)),
    )
    powers[0] = np.eye(d)
    for j in range(FRAMES_PER_BLOCK):
        powers[j + 1] = A @ powers[j]
    answer = powers[:-1] @ b
    for j in range(1, FRAMES_PER_BLOCK + 1):
        pulses[j, :, :j] = answer[:j][::-1].T
    return FrameBlock(powers.reshape(-1, d), pulses.reshape(-1, FRAMES_PER_BLOCK))


def filtered(block: Matrices, driven: np.ndarray) -> np.ndarray:
    """Return the output ``(N,)`` of a sampled block with one input and one output, from rest."""
    prepared, out = stretch(block.A, block.B[:, 0]), np.empty(driven.size)
    state = np.zeros(block.A.shape[0])
    for k in range(0, driven.size, FRAMES_PER_BLOCK):
        part = driven[k : k + FRAMES_PER_BLOCK]
        states = prepared.states(state, part)
        out[k : k + FRAMES_PER_BLOCK] = states[:-1] @ block.C[0] + block.D[0, 0] * part
        state = states[-1]
    return out


@dataclass(frozen=True, eq=False)
class FreeFrames:
    """The loop with every ram free: plant states, then the computer's.

    Attributes
    ----------
    prepared : the loop over a block of frames.
    watch, offset : ``(v, d)`` and ``(v,)``: a frame is free where ``|watch w + offset|`` stays
        below one.
    command : ``(d,)``, u_p.
    inner : ``(n, d)``, plant states at the time within the frame that a record samples.
    """

    prepared: FrameBlock
    watch: np.ndarray
    offset: np.ndarray
    command: np.ndarray
    inner: np.ndarray

    def ahead(self, start: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return w at the free frames from ``start`` on and at the one after them, ``(f + 1, d)``;
        ``reference (k,)`` in g at the frames.
        """
        states = self.prepared.states(start, reference[:FRAMES_PER_BLOCK])
        seen = np.abs(states[:-1] @ self.watch.T + self.offset).max(axis=1)
        limited = np.flatnonzero(~(seen < LIMIT_SHARE))
        return states if limited.size == 0 else states[: limited[0] + 1]


def free_frames(x29: X29, steppers: Sequence[Stepper], departure: float) -> FreeFrames:
    """Prepare the loop of an aircraft; ``departure`` rad of alpha ends a flight."""
    law, mix, n = law_matrices(x29.law), mixing(x29), plant(x29).A.shape[0]
    d = n + law.A.shape[0]
    command = np.concatenate([np.zeros(n), law.C[0]])
    # The extended state of the steppers, plant states, commands and one, from w; the last by
    # ``offset``.
    state, watch, offset = np.eye(n, d), [], []
    inner = state
    for stepper in steppers:
        inner = state
        extended = np.concatenate([state, np.outer(mix, command)])
        watch.append(stepper.watch[:, :-1] @ extended)
        offset.append(stepper.watch[:, -1])
        state = stepper.free[:n, :-1] @ extended
    for i, surface in enumerate(x29.surfaces):
        half = (surface.upper - surface.lower) / 2.0
        middle = (surface.upper + surface.lower) / 2.0 - surface.trim
        watch.append(mix[i] / half * command[None])
        offset.append(np.array([-middle / half]))
    watch.append(np.eye(1, d) / departure)
    offset.append(np.zeros(1))
    sensed = law.B[:, 1:] @ plant(x29).C[6:8]
    A = np.concatenate([state, np.concatenate([sensed, law.A], axis=1)])
    b = np.concatenate([np.zeros(n), law.B[:, 0]])
    return FreeFrames(stretch(A, b), np.concatenate(watch), np.concatenate(offset), command, inner)


# ---- Simulation of the sampled closed loop with its limits and break-out

Stick = Callable[[np.ndarray], np.ndarray]
# Beyond this angle of attack (rad) linear derivatives do not hold, and the flight ends.
_DEPARTURE_ALPHA = 1.0
_SINGLE_FRAMES_AFTER_LIMIT = 8  # frames that are stepped one by one after one that was limited


class FlightOutcome(Enum):
    """End of a simulated flight."""

    COMPLETED = "completed"
    DEPARTED = "departed"


@dataclass(frozen=True, eq=False)
class ClosedLoopTruth:
    """True histories at the F frames of the control computer (80 Hz).

    Attributes
    ----------
    time : ``(F,)``, s.
    stick, reference, command : ``(F,)``; stick as the computer read it (in), r (g), u_p (deg) held
        from this frame on.
    alpha, q, nz : ``(F,)``; rad and rad/s about trim, total g at the centre of gravity.
    surfaces : ``(3, F)``, deg about trim; canard, flaperon, strake.
    command_limited, rate_limited, stopped : ``(3, F)`` bool: the command was cut to the travel; the
        ram was at its rate limit, or at an end of its travel, at some instant of the frame that
        begins there.
    recorded : ``(3, N)``, the record's outputs without noise.
    outcome : COMPLETED, or DEPARTED when alpha passed 1 rad; the flight and the record end there.
    """

    time: np.ndarray
    stick: np.ndarray
    reference: np.ndarray
    command: np.ndarray
    alpha: np.ndarray
    q: np.ndarray
    nz: np.ndarray
    surfaces: np.ndarray
    command_limited: np.ndarray
    rate_limited: np.ndarray
    stopped: np.ndarray
    recorded: np.ndarray
    outcome: FlightOutcome


def fly_closed_loop(
    x29: X29,
    stick: Stick | np.ndarray,
    duration: float,
    rng: np.random.Generator | None = None,
    *,
    pieces: int = 8,
) -> tuple[Record, ClosedLoopTruth]:
    """Fly from trim for ``duration`` s and return the telemetry record with the truth.

    Within a frame (12.5 ms) the plant is stepped exactly by the matrix exponential with the command
    held; rate and position limits are exact except for a limit reached and left within 1/``pieces``
    of a frame (see ``sim.closed_loop.equations``). The computer reads the stick and both sensors at
    the frame and changes the command one frame later.

    Parameters
    ----------
    stick : a function of time (array of s to array of in, aft +), read at the frames, or an array
        with one value a frame.
    rng : generator of the measurement noise of ``x29.telemetry``; None for no noise.
    pieces : number of times in a frame at which limits are checked.

    Returns
    -------
    Record : input ``stick`` (in, previous value held), outputs ``alpha`` (rad, vane: alpha -
        (arm/V) q), ``q`` (rad/s) and ``nz`` (total, g, 1 in trim), 40 Hz from 0 to ``duration``.
        The recorder has its own sensors, without lag. With a ``recorded_skew`` the row at time t
        holds the stick at t and the outputs at t - skew: the stick leads.
    ClosedLoopTruth : see there.

    Raises
    ------
    ModelError : a duration of less than two rows, a stick that is too short or not finite,
        telemetry that does not fall on frames, a negative skew, fewer than one piece.
    """
    every = _frames_per_row(x29)
    time = _frame_times(x29, duration, every)
    if pieces < 1:
        raise ModelError(f"{pieces} pieces", where="fly_closed_loop", remedy="give 1 or more")
    read = _stick_at_frames(stick, time)
    simulated = _fly(x29, _reference(x29, read), pieces)

    count = simulated.states.shape[0]
    system = plant(x29)
    at_frames = system.C @ simulated.states.T
    rows = np.arange(0, count, every)
    recorded = (system.C[:3] @ _states_at_rows(x29, simulated, rows).T).copy()
    recorded[0] -= x29.telemetry.vane_arm / x29.airframe.airspeed * recorded[1]
    recorded[2] += 1.0
    truth = ClosedLoopTruth(
        time=time[:count],
        stick=read[:count],
        reference=simulated.reference[:count],
        command=simulated.command,
        alpha=at_frames[0],
        q=at_frames[1],
        nz=at_frames[2] + 1.0,
        surfaces=at_frames[3:6],
        command_limited=simulated.command_limited.T,
        rate_limited=simulated.rate_limited.T,
        stopped=simulated.stopped.T,
        recorded=recorded,
        outcome=simulated.outcome,
    )
    noise = np.array(
        [[x29.telemetry.alpha_noise], [x29.telemetry.q_noise], [x29.telemetry.nz_noise]]
    )
    measured = recorded if rng is None else recorded + noise * rng.standard_normal(recorded.shape)
    units = (("alpha", "rad"), ("q", "rad/s"), ("nz", "g"))
    outputs = tuple(
        Channel.of(name, unit, values) for (name, unit), values in zip(units, measured, strict=True)
    )
    return Record(
        time[rows], (Channel.of("stick", "in", read[rows]),), outputs, name=f"x29 {x29.name}"
    ), truth


@dataclass(frozen=True, eq=False)
class _FrameStates:
    """Plant states at the frames and, for a skewed record, within them; commands and limits; one
    row a frame.
    """

    states: np.ndarray
    inner_states: np.ndarray
    reference: np.ndarray
    command: np.ndarray
    command_limited: np.ndarray
    rate_limited: np.ndarray
    stopped: np.ndarray
    outcome: FlightOutcome


def _fly(x29: X29, reference: np.ndarray, pieces: int) -> _FrameStates:
    system, law = plant(x29), law_matrices(x29.law)
    n, count = system.A.shape[0], reference.size
    steppers = _steppers(x29, pieces)
    free = free_frames(x29, steppers, _DEPARTURE_ALPHA)
    mix = mixing(x29)
    lower = np.array([surface.lower - surface.trim for surface in x29.surfaces])
    upper = np.array([surface.upper - surface.trim for surface in x29.surfaces])
    # The computer's next state and u_p from r, its own state and the plant's: one product a frame.
    sensed = law.B[:, 1:] @ system.C[6:8]

    states, inner = np.zeros((count, n)), np.zeros((count, n))
    command, limited = np.zeros(count), np.zeros((count, 3), dtype=bool)
    rate_limited, stopped = np.zeros((count, 3), dtype=bool), np.zeros((count, 3), dtype=bool)
    state, computer, modes = np.zeros(n + 4), np.zeros(law.A.shape[0]), ALL_FREE
    state[-1] = 1.0
    outcome, k, again = FlightOutcome.COMPLETED, 0, 0
    while k < count:
        if k >= again and modes == ALL_FREE:
            ahead = free.ahead(np.concatenate([state[:n], computer]), reference[k:])
            part = slice(k, k + len(ahead) - 1)
            states[part], inner[part], command[part] = (
                ahead[:-1, :n],
                ahead[:-1] @ free.inner.T,
                ahead[:-1] @ free.command,
            )
            state[:n], computer, k = ahead[-1, :n], ahead[-1, n:], part.stop
            again = k if len(ahead) > FRAMES_PER_BLOCK else k + _SINGLE_FRAMES_AFTER_LIMIT
            continue
        states[k] = state[:n]
        if abs(state[0]) > _DEPARTURE_ALPHA:
            outcome, count = FlightOutcome.DEPARTED, k + 1
            break
        command[k] = u_p = float(law.C[0] @ computer)
        computer = law.A @ computer + law.B[:, 0] * reference[k] + sensed @ state[:n]
        wanted = mix * u_p
        allowed = np.minimum(np.maximum(wanted, lower), upper)
        limited[k] = wanted != allowed
        state[n : n + 3] = allowed
        for stepper in steppers:
            inner[k] = state[:n]
            state, modes, seen = advance(stepper, state, modes)
            for active in seen:
                for i, mode in enumerate(active):
                    rate_limited[k, i] |= mode in (RamMode.RATE_UP, RamMode.RATE_DOWN)
                    stopped[k, i] |= mode in (RamMode.STOP_UPPER, RamMode.STOP_LOWER)
        k += 1
    return _FrameStates(
        states[:count],
        inner[:count],
        reference,
        command[:count],
        limited[:count],
        rate_limited[:count],
        stopped[:count],
        outcome,
    )


def _steppers(x29: X29, pieces: int) -> tuple[Stepper, ...]:
    """Return one stepper a frame, or two if a skewed record samples its outputs in between."""
    system, rest = plant(x29), math.fmod(x29.stick.recorded_skew, x29.frame)
    if rest == 0.0:
        return (prepare(x29, system, x29.frame, pieces),)
    spans = (x29.frame - rest, rest)
    return tuple(prepare(x29, system, span, math.ceil(pieces * span / x29.frame)) for span in spans)


def _states_at_rows(x29: X29, flown: _FrameStates, rows: np.ndarray) -> np.ndarray:
    """Return plant states ``recorded_skew`` before the given frames; trim before the flight."""
    whole, rest = divmod(x29.stick.recorded_skew, x29.frame)
    source, frames = (
        (flown.inner_states, rows - int(whole) - 1) if rest else (flown.states, rows - int(whole))
    )
    return np.where(frames[:, None] >= 0, source[np.maximum(frames, 0)], 0.0)


def _reference(x29: X29, stick: np.ndarray) -> np.ndarray:
    """Return r (g) at every frame, after break-out, gearing, delay and lag."""
    return filtered(shaping_matrices(x29.stick, x29.frame), shape_stick(stick, x29.stick))


def _stick_at_frames(stick: Stick | np.ndarray, time: np.ndarray) -> np.ndarray:
    given = np.asarray(stick if isinstance(stick, np.ndarray) else stick(time), dtype=float)
    if given.ndim != 1 or given.size < time.size:
        what = f"{given.size} stick values for {time.size} frames"
        raise ModelError(
            what, where="fly_closed_loop", remedy="give one value a frame, the last included"
        )
    if not np.all(np.isfinite(given[: time.size])):
        raise ModelError(
            "a stick value is not finite", where="fly_closed_loop", remedy="give numbers throughout"
        )
    return given[: time.size]


def _frame_times(x29: X29, duration: float, every: int) -> np.ndarray:
    """Return the times of the computer's frames, s; at least two rows of the record."""
    frames = round(duration * x29.law.frame_rate) if math.isfinite(duration) else 0
    if frames < every:
        raise ModelError(
            f"a duration of {duration:g} s",
            where="fly_closed_loop",
            remedy=f"fly for at least {every * x29.frame:g} s",
        )
    return x29.frame * np.arange(frames + 1)


def _frames_per_row(x29: X29) -> int:
    ratio = x29.law.frame_rate / x29.telemetry.rate
    if ratio < 1 or ratio != round(ratio):
        raise ModelError(
            f"telemetry at {x29.telemetry.rate:g} Hz does not fall on frames at "
            f"{x29.law.frame_rate:g} Hz",
            where=f"x29 {x29.name}",
            remedy="give a rate that divides the frame rate",
        )
    if x29.stick.recorded_skew < 0:
        raise ModelError(
            f"recorded_skew {x29.stick.recorded_skew:g} s",
            where=f"x29 {x29.name}",
            remedy="give 0 or more",
        )
    return round(ratio)
