"""Associative scans against the recursions that they stand for, one sample after the other."""

from __future__ import annotations

import numpy as np
import pytest

from ident.process_noise.whitener import (
    Elements,
    apply_steps,
    combine_affine,
    combine_covariances,
    covariance_steps,
    multiply_left,
    multiply_right,
    powers,
    scan,
    transpose_each,
)


def kalman_covariances(
    P: np.ndarray, Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, R: np.ndarray
) -> np.ndarray:
    """Filtered covariances after each sample: prediction and Joseph's update, in a loop."""
    out = []
    for F, noise, C in zip(Phi, Q, H, strict=True):
        P = F @ P @ F.T + noise
        S = C @ P @ C.T + np.diag(R)
        K = np.linalg.solve(S, C @ P).T
        open_loop = np.eye(len(P)) - K @ C
        P = open_loop @ P @ open_loop.T + K @ np.diag(R) @ K.T
        out.append(P)
    return np.array(out)


def problem(rng: np.random.Generator, count: int, n: int, m: int) -> tuple[np.ndarray, ...]:
    """Start, transitions, noise of rank one, measurements with some missing (rows of
    zeros), variances.
    """
    Phi = np.eye(n) + 0.2 * rng.normal(size=(count, n, n))
    drive = rng.normal(size=(count, n, 1))
    H = rng.normal(size=(count, m, n)) * (rng.random((count, m, 1)) > 0.3)
    root = rng.normal(size=(n, n))
    return root @ root.T, Phi, drive @ drive.transpose(0, 2, 1), H, rng.uniform(0.1, 2.0, m)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 33])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 2), (2, 4)])
def test_covariances_are_those_of_the_sequential_filter(count: int, n: int, m: int) -> None:
    P, Phi, Q, H, R = problem(np.random.default_rng(100 * count + n), count, n, m)
    got = apply_steps(scan(combine_covariances, covariance_steps(Phi, Q, H, R)), P)
    expected = kalman_covariances(P, Phi, Q, H, R)
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


def test_a_start_without_variance_is_no_exception() -> None:
    _, Phi, Q, H, R = problem(np.random.default_rng(5), 20, 3, 2)
    got = apply_steps(scan(combine_covariances, covariance_steps(Phi, Q, H, R)), np.zeros((3, 3)))
    expected = kalman_covariances(np.zeros((3, 3)), Phi, Q, H, R)
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


def test_powers_of_one_step_are_its_repetition() -> None:
    P, Phi, Q, H, R = problem(np.random.default_rng(6), 1, 3, 2)
    got = apply_steps(powers(combine_covariances, covariance_steps(Phi, Q, H, R), 8), P)
    expected = kalman_covariances(
        P, np.repeat(Phi, 8, axis=0), np.repeat(Q, 8, axis=0), np.repeat(H, 8, axis=0), R
    )
    assert len(got) == 8
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-11 * np.abs(expected).max())


def test_two_steps_in_a_row_combine_in_their_order() -> None:
    P, Phi, Q, H, R = problem(np.random.default_rng(7), 2, 3, 2)
    first, second = (
        covariance_steps(Phi[k : k + 1], Q[k : k + 1], H[k : k + 1], R) for k in (0, 1)
    )
    both, swapped = combine_covariances(first, second), combine_covariances(second, first)
    expected = kalman_covariances(P, Phi, Q, H, R)[1]
    np.testing.assert_allclose(apply_steps(both, P)[0], expected, rtol=1e-10, atol=1e-11)
    assert not np.allclose(apply_steps(swapped, P)[0], expected, rtol=1e-3)


@pytest.mark.parametrize("count", [2, 5, 12])
def test_affine_steps_of_several_quantities(count: int) -> None:
    """X[k] = T X[k - 1] T' + D, for four X at once."""
    rng = np.random.default_rng(count)
    T, D = 0.7 * rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 4, 3, 3))
    start = rng.normal(size=(4, 3, 3))
    through, added = scan(combine_affine, (T, np.ascontiguousarray(D.transpose(0, 2, 1, 3))))
    expected = start
    for k in range(count):
        expected = np.array([T[k] @ X @ T[k].T + E for X, E in zip(expected, D[k], strict=True)])
        got = np.array([through[k] @ X @ through[k].T for X in start]) + added[k].transpose(1, 0, 2)
        np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-12)


def test_prefixes_of_something_that_does_not_commute() -> None:
    rng = np.random.default_rng(8)
    M = rng.normal(size=(11, 2, 2))

    def product(first: Elements, second: Elements) -> Elements:
        return (second[0] @ first[0],)

    expected, prefixes = np.eye(2), scan(product, (M,))[0]
    for k in range(11):
        expected = M[k] @ expected
        np.testing.assert_allclose(prefixes[k], expected, rtol=1e-12, atol=1e-12)


def test_products_with_stacks_of_matrices() -> None:
    rng = np.random.default_rng(9)
    left, stack, right = (
        rng.normal(size=(5, 2, 3)),
        rng.normal(size=(5, 3, 6, 4)),
        rng.normal(size=(5, 4, 2)),
    )
    for k in range(5):
        for d in range(6):
            np.testing.assert_allclose(
                multiply_left(left, stack)[k, :, d], left[k] @ stack[k, :, d], rtol=1e-12
            )
            np.testing.assert_allclose(
                multiply_right(stack, right)[k, :, d], stack[k, :, d] @ right[k], rtol=1e-12
            )
            np.testing.assert_array_equal(transpose_each(stack)[k, :, d], stack[k, :, d].T)
