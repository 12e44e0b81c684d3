"""Nine fourteen-state filters over ten seconds at 40 Hz: the batched bank, filterpy one by one and,
where installed, JAX, in one run.

    python benchmarks/loes_bank.py [--rounds N]

All three do the same work on the same record and must agree on every log-likelihood. Times are
medians of interleaved rounds, and ratios are what to quote: the machine may be shared. The 1990
program took 150 s. For a steady figure set OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from ident.banks.bank import bank_runs, run_bank
from ident.banks.delays import DELAYS
from ident.filters.ekf import FilterSettings, run_ekf
from scenarios.identification.low_order import PAPER_START, loes_filter_system
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.nonlinear import fly_closed_loop, three_two_one_one
from sim.declaration.model import System
from sim.record import Record
from sim.vehicles.factory import model_from_constants


def problem() -> tuple[Record, System]:
    """The first ten seconds of the flight-like airframe's standard record and the filter for it."""
    x29 = load_x29("F")
    record = fly_closed_loop(x29, three_two_one_one(1.0, 0.5, 1.0), 10.0, np.random.default_rng(1))[
        0
    ]
    constants = {
        "airspeed": x29.airframe.airspeed,
        "gravity": x29.airframe.gravity,
        "vane_arm": x29.telemetry.vane_arm,
    }
    noise = {
        "alpha": x29.telemetry.alpha_noise,
        "q": x29.telemetry.q_noise,
        "nz": x29.telemetry.nz_noise,
    }
    return record, loes_filter_system(
        model_from_constants("loes", constants, PAPER_START), record, noise, {"q": 1e-6}
    )


def one_by_one(record: Record, system: System) -> np.ndarray:
    """Log-likelihoods of nine filterpy filters, one after the other."""
    held = [
        replace(system, parameters=system.parameters.with_values({"delay": delay}))
        for delay in DELAYS
    ]
    return np.array([run_ekf(record, each).log_likelihood for each in held])


def batched(record: Record, system: System) -> np.ndarray:
    """Log-likelihoods of the bank."""
    return run_bank(record, system, fixed_values={"delay": np.array(DELAYS)}).log_likelihood


def jax_bank(record: Record, system: System) -> Callable[[], np.ndarray]:
    """A plain JAX version of the same filter: scan over samples, vmap over delays, jitted; the
    first call compiles.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    laid_out, runs = bank_runs(
        record, system, FilterSettings(), fixed_values={"delay": np.array(DELAYS)}
    )
    held = {
        name: float(system.parameters[name].value) for name in ("airspeed", "gravity", "vane_arm")
    }
    V, g, arm = held["airspeed"], held["gravity"], held["vane_arm"]
    dt, Q, R = (
        float(laid_out.grid.steps[0]),
        jnp.diag(jnp.array(laid_out.density)),
        jnp.diag(jnp.array(laid_out.variance)),
    )

    def rates(x, u):  # type: ignore[no-untyped-def]
        alpha, q, delta, L_a, M_a, L_d, M_d, L_q, M_q, inv_tau, L_0, M_0, d_0, _ = x
        moving = jnp.array(
            [
                L_a * alpha + L_q * q + L_d * delta + L_0,
                M_a * alpha + M_q * q + M_d * delta + M_0,
                inv_tau * (u - delta) + d_0,
            ]
        )
        return jnp.concatenate([moving, jnp.zeros(11)])

    def outputs(x, u):  # type: ignore[no-untyped-def]
        return jnp.array([x[0] - arm / V * x[1], x[1], V / g * (x[1] - rates(x, u)[0]) + x[13]])

    def update(x, P, z, u):  # type: ignore[no-untyped-def]
        H = jax.jacfwd(outputs)(x, u)
        y, S = z - outputs(x, u), H @ P @ H.T + R
        K = jnp.linalg.solve(S, H @ P).T
        joseph = jnp.eye(14) - K @ H
        gained = -0.5 * (
            y @ jnp.linalg.solve(S, y) + jnp.linalg.slogdet(S)[1] + 3.0 * jnp.log(2.0 * jnp.pi)
        )
        return x + K @ y, joseph @ P @ joseph.T + K @ R @ K.T, gained

    def sample(carry, data):  # type: ignore[no-untyped-def]
        x, P = carry
        z, u, u_now = data
        F = jax.jacfwd(rates)(x, u)
        powers = [jnp.eye(14), F, F @ F / 2.0]
        Phi = sum(power * dt**k for k, power in enumerate(powers))
        noise = sum(
            a @ Q @ b.T * (dt ** (i + j + 1) / (i + j + 1))
            for i, a in enumerate(powers)
            for j, b in enumerate(powers)
        )
        k1 = rates(x, u)
        k2 = rates(x + 0.5 * dt * k1, u)
        k3 = rates(x + 0.5 * dt * k2, u)
        k4 = rates(x + dt * k3, u)
        x, P, gained = update(
            x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), Phi @ P @ Phi.T + noise, z, u_now
        )
        return (x, P), gained

    def run(stage, begin):  # type: ignore[no-untyped-def]
        x, P, first = update(start, covariance, z[0], begin[0])
        _, gained = jax.lax.scan(sample, (x, P), (z[1:], stage, begin[1:]))
        return first + gained.sum()

    # The free parameters in the order that rates() unpacks, not the declaration's.
    order = [
        laid_out.names.index(name)
        for name in (
            "alpha",
            "q",
            "delta",
            "L_alpha",
            "M_alpha",
            "L_delta",
            "M_delta",
            "L_q",
            "M_q",
        )
    ]
    order += [laid_out.names.index(name) for name in ("inv_tau", "L_0", "M_0", "delta_0", "nz_0")]
    start, covariance = (
        jnp.array(laid_out.start[order]),
        jnp.array(laid_out.covariance[np.ix_(order, order)]),
    )
    Q, z = Q[np.ix_(order, order)], jnp.array(laid_out.z.T)
    stage, begin = jnp.array(runs.drive.stages[0][0].T), jnp.array(runs.drive.begin[0].T)
    compiled = jax.jit(jax.vmap(run))
    return lambda: np.asarray(compiled(stage, begin))


def timed(work: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Wall time in s and what the work returned."""
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def main() -> None:
    """Run, check that all agree, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    record, system = problem()
    works: dict[str, Callable[[], np.ndarray]] = {
        "bank": lambda: batched(record, system),
        "filterpy one by one": lambda: one_by_one(record, system),
    }
    first: dict[str, float] = {}
    if find_spec("jax"):
        begin = time.perf_counter()
        works["JAX, compiled"] = jax_bank(record, system)
        works["JAX, compiled"]()
        first["JAX, first call with its import and compilation"] = time.perf_counter() - begin
    times: dict[str, list[float]] = {name: [] for name in works}
    results: dict[str, np.ndarray] = {}
    for turn in range(rounds):
        for name, work in works.items():
            if name.startswith("filterpy") and turn >= 2:
                continue
            seconds, results[name] = timed(work)
            times[name].append(seconds)
    reference = statistics.median(times["bank"])
    print(
        f"nine filters of {len(system.states) + len(system.parameters.free_names)} states, "
        f"{len(record)} samples, {rounds} rounds"
    )
    for name, values in {**times, **{name: [value] for name, value in first.items()}}.items():
        median = statistics.median(values)
        print(
            f"{name:52s} {median:8.3f} s   {median / reference:7.1f} x the bank   best "
            f"{min(values):.3f} s"
        )
    for name, result in results.items():
        print(
            f"{name:52s} largest difference in log-likelihood "
            f"{np.max(np.abs(result - results['bank'])):.1e}"
        )


if __name__ == "__main__":
    main()
