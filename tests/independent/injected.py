"""Faults of sensors and surfaces, put into a flight afterwards: they act on the true signals of the
fine grid, before sampling and noise.

Each is written from its definition in words. An engineer's sign holds throughout: a positive delay
or lag is late, an arm is ahead of the c.g.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.independent.flight import G0, Flight

Fault = Callable[[Flight], Flight]


def later(flight: Flight, name: str, delay: float) -> Flight:
    """A signal shown ``delay`` seconds late (early where negative), by linear interpolation; the
    ends repeat.
    """
    values = flight.signal(name)
    return flight.with_signal(name, np.interp(flight.time - delay, flight.time, values))


def late_sensor(name: str, delay: float) -> Fault:
    return lambda flight: later(flight, name, delay)


def lagging_sensor(name: str, lag: float) -> Fault:
    """First order: lag y_dot = true - y, exact for a signal that runs straight between grid
    points.
    """

    def act(flight: Flight) -> Flight:
        true, h = flight.signal(name), flight.step
        keep = np.exp(-h / lag)
        shown = np.empty_like(true)
        shown[0] = true[0]
        for k in range(1, len(true)):
            slope = (true[k] - true[k - 1]) / h
            shown[k] = true[k] - lag * slope + (shown[k - 1] - true[k - 1] + lag * slope) * keep
        return flight.with_signal(name, shown)

    return act


def vane_ahead(arm: float) -> Fault:
    """A vane ``arm`` m ahead of the c.g. feels the air of its own pitching: alpha - (arm/V) q."""
    return lambda flight: flight.with_signal(
        "alpha", flight.alpha - arm / flight.airspeed * flight.q
    )


def wrong_scale(name: str, factor: float) -> Fault:
    """The change since the start times ``factor``: where the zero of a sensor lies is no matter
    here.
    """

    def act(flight: Flight) -> Flight:
        values = flight.signal(name)
        return flight.with_signal(name, values[0] + factor * (values - values[0]))

    return act


def accelerometer_ahead(arm: float) -> Fault:
    """An accelerometer ``arm`` m ahead of the c.g. (behind: negative): nz + (arm/g0) q_dot."""
    return lambda flight: flight.with_signal("nz", flight.nz + arm / G0 * flight.rate_of("q"))


def surface_follows_late(delay: float) -> Fault:
    """The record holds the command, the surface is where it was asked to be ``delay`` s earlier."""
    return lambda flight: later(flight, "elevator", -delay)


def surface_recorded_late(delay: float) -> Fault:
    """The recorder shows the surface ``delay`` s after it was there."""
    return lambda flight: later(flight, "elevator", delay)


def gyro_feels_load(gain: float) -> Fault:
    """A rate gyro bent by the load factor: q + gain (nz - nz at the start), gain in rad/s per g."""
    return lambda flight: flight.with_signal("q", flight.q + gain * (flight.nz - flight.nz[0]))


def curved_calibration(name: str, curvature: float) -> Fault:
    """y + curvature y^2 of the change y since the start; curvature in one over the unit."""

    def act(flight: Flight) -> Flight:
        change = flight.signal(name) - flight.signal(name)[0]
        return flight.with_signal(name, flight.signal(name) + curvature * change**2)

    return act


def zero_steps(name: str, share: float, size: float) -> Fault:
    """The zero of a sensor jumps by ``size`` at a share of the record."""

    def act(flight: Flight) -> Flight:
        after = flight.time >= share * flight.time[-1]
        return flight.with_signal(name, flight.signal(name) + size * after)

    return act


def drifting(name: str, rate: float) -> Fault:
    return lambda flight: flight.with_signal(name, flight.signal(name) + rate * flight.time)


def held(name: str, period: float) -> Fault:
    """Sample and hold: the value is taken every ``period`` seconds and shown until the next."""

    def act(flight: Flight) -> Flight:
        taken = np.floor(flight.time / period + 1e-9) * period
        return flight.with_signal(name, np.interp(taken, flight.time, flight.signal(name)))

    return act


def clock_fast(factor: float) -> Fault:
    """The recorder's clock gains: what it calls t happened at t/factor. The end, for which nothing
    was flown, repeats the last state.
    """

    def act(flight: Flight) -> Flight:
        true = flight.time / factor
        for name in ("elevator", "alpha", "q", "nz", "theta", "airspeed"):
            flight = flight.with_signal(name, np.interp(true, flight.time, flight.signal(name)))
        return flight

    return act


def nothing(flight: Flight) -> Flight:
    return flight
