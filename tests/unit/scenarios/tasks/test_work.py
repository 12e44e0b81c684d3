"""Seeds of tasks: NumPy's own spawning, and no task in two studies."""

from __future__ import annotations

import numpy as np

from scenarios.tasks.work import SEED_BITS, seed_of, tasks_of


def test_a_seed_is_that_of_the_spawned_child() -> None:
    children = np.random.SeedSequence(12).spawn(5)
    assert [seed_of(12, k) for k in range(5)] == [
        int(child.generate_state(1, np.uint64)[0]) >> 11 for child in children
    ]
    assert all(0 <= seed_of(root, k) < 2**SEED_BITS for root in (0, 1, 2**63) for k in range(20))


def test_neighbouring_roots_share_no_task() -> None:
    seeds = [task.seed for root in range(20) for task in tasks_of(root, range(200))]
    assert len(set(seeds)) == len(seeds)
