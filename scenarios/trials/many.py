"""Many flights, one seed each, shared out among processes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Found = TypeVar("Found")


def of_each_seed(
    fly: Callable[[int], Found], seeds: range, progress: Callable[[str, float], None] = lambda stage, share: None, workers: int = 1
) -> tuple[Found, ...]:
    """What ``fly`` finds for each seed, in their order: one after another, or shared out among ``workers`` processes, on which nothing depends."""
    count = len(seeds)

    def tell(done: int) -> None:
        progress(f"{done} of {count} flights", done / count)

    progress(f"flying {count} flights", 0.0)
    if workers < 2:
        found = []
        for seed in seeds:
            found.append(fly(seed))
            tell(len(found))
        return tuple(found)
    with ProcessPoolExecutor(min(workers, count)) as pool:
        futures = [pool.submit(fly, seed) for seed in seeds]
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                tell(done)
        finally:
            pool.shutdown(cancel_futures=True)
        return tuple(future.result() for future in futures)
