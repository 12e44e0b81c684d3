"""dynamax's extended Kalman filter, jitted in double precision; the first call compiles.

dynamax linearises the Runge-Kutta step itself, where the others hold F over a step: its estimates
differ by tenths of a sigma.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter

from benchmarks.peers.short_period import Problem, scales_of

jax.config.update("jax_enable_x64", True)


def filter_of(problem: Problem) -> Callable[[Any], Any]:
    """From outputs ``(N, 2)`` of one record to dynamax's posterior."""
    lift, moment, hat = scales_of(problem)
    dt = float(problem["time"][1] - problem["time"][0])

    def rates(x: Any, u: Any) -> Any:
        alpha, q, CL_alpha, CL_q, CL_de, Cm_alpha, Cm_q, Cm_de = x
        alpha_rate = q - lift * (CL_alpha * alpha + CL_q * hat * q + CL_de * u)
        return jnp.concatenate(
            [
                jnp.array([alpha_rate, moment * (Cm_alpha * alpha + Cm_q * hat * q + Cm_de * u)]),
                jnp.zeros(6),
            ]
        )

    def moved(x: Any, u: Any) -> Any:
        k1 = rates(x, u[0])
        k2 = rates(x + 0.5 * dt * k1, u[0])
        k3 = rates(x + 0.5 * dt * k2, u[0])
        return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + rates(x + dt * k3, u[0]))

    params = ParamsNLGSSM(
        initial_mean=jnp.array(problem["start"]),
        initial_covariance=jnp.diag(jnp.array(problem["start_std"]) ** 2),
        dynamics_function=moved,
        dynamics_covariance=jnp.zeros((8, 8)),
        emission_function=lambda x, u: x[:2],
        emission_covariance=jnp.diag(jnp.array(problem["noise_std"]) ** 2),
    )
    # dynamax moves to a sample with the input of that sample; a held input is that of the sample
    # before.
    held = jnp.array(np.concatenate([[0.0], problem["elevator"][:-1]]))[:, None]
    fields = ["filtered_means", "filtered_covariances"]
    return lambda z: extended_kalman_filter(params, z, inputs=held, output_fields=fields)


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    run = filter_of(problem)

    @jax.jit
    def one(z: Any) -> Any:
        post = run(z)
        return (
            post.filtered_means,
            jnp.sqrt(jnp.diagonal(post.filtered_covariances, axis1=1, axis2=2)),
            post.marginal_loglik,
        )

    z = jnp.array(problem["z"].T)

    def work() -> dict[str, np.ndarray]:
        mean, std, total = (np.asarray(each) for each in one(z))
        return {
            "mean": mean,
            "std": std,
            "estimate": mean[-1, 2:],
            "estimate_std": std[-1, 2:],
            "log_likelihood": total,
        }

    return work
