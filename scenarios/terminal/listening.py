"""What a command prints, kept as tables and sentences instead of being laid out: pages say the same as the terminal does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from rich.console import Console

ENDLESS = 1_000_000  # columns: nothing is folded, no table is parted


@dataclass(frozen=True)
class Told:
    """A table that was printed: its title, and of each column the heading and the cells."""

    title: str
    columns: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass
class Listener:
    """Stands where a console does; ``heard`` are tables and sentences in their order."""

    heard: list[Told | str] = field(default_factory=list)
    width: int = ENDLESS
    is_terminal: bool = False

    def print(self, *said: Any, **_: Any) -> None:
        """Keep a line; empty ones only separate."""
        text = " ".join(str(each) for each in said).strip()
        if text:
            self.heard.append(text)


def heard_of(out: object) -> list[Told | str] | None:
    """Where a listener keeps what it hears; None of a console."""
    return out.heard if isinstance(out, Listener) else None


def listened(show: Callable[[Console], object]) -> Sequence[Told | str]:
    """The tables and sentences that ``show`` prints."""
    listener = Listener()
    show(cast("Console", listener))
    return listener.heard
