"""What is left of a campaign that Ctrl-C ends: the flights that had ended, their table, and a line that says so."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenarios.trials.many import Interrupted


@dataclass
class Flown:
    """Flights that have ended: what was found, and by which seeds; ``whole`` False where the campaign was stopped before all had."""

    asked: int
    found: Sequence[Any] = ()
    seeds: Sequence[int] = field(default_factory=list)

    @property
    def whole(self) -> bool:
        return len(self.seeds) == self.asked

    @property
    def words(self) -> str:
        """``"seeds 1 to 20"``, or which of them where it was stopped."""
        if self.whole:
            return f"seeds {self.seeds[0]} to {self.seeds[-1]}"
        return f"stopped after {len(self.seeds)} of {self.asked}, seeds {', '.join(map(str, self.seeds))}"

    @property
    def content(self) -> dict[str, Any]:
        """What ``campaign.json`` says of it: first seed and number, of a campaign that was stopped also the seeds that it has."""
        return {"first_seed": self.seeds[0], "runs": len(self.seeds)} | ({} if self.whole else {"asked": self.asked, "seeds": list(self.seeds)})


def flown(campaign: Callable[[], Sequence[Any]], seeds: range) -> Flown:
    """Fly; where Ctrl-C comes, what had ended by then. Raises KeyboardInterrupt where nothing had."""
    try:
        return Flown(len(seeds), tuple(campaign()), tuple(seeds))
    except Interrupted as stopped:
        if not stopped.found:
            raise KeyboardInterrupt(f"no flight of {len(seeds)} had ended") from None
        ended = sorted(stopped.found)
        return Flown(len(seeds), tuple(stopped.found[seed] for seed in ended), tuple(ended))


@contextmanager
def stopped_after(flights: int, asked: int, out: Path | None) -> Iterator[None]:
    """While a campaign is printed and written; raises KeyboardInterrupt with what is kept where fewer flew than were asked."""
    yield
    if flights < asked:
        raise KeyboardInterrupt(f"the table of the {flights} of {asked} runs that had ended is {f'in {out}' if out is not None else 'printed above'}")
