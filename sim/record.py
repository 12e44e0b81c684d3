"""A record of a flight test: time, inputs and outputs, with names, units and missing samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from sim.errors import RecordError, time_span

LARGEST_MEASURED = 1e6  # rad, rad/s, m/s or g; larger values occur in no flight


class Hold(Enum):
    """How an input behaves between two samples."""

    PREVIOUS = "previous"
    LINEAR = "linear"


@dataclass(frozen=True, eq=False, repr=False)
class Channel:
    """One measured signal.

    Attributes
    ----------
    name : ``"alpha"``, ``"q"``, ...
    unit : unit of ``values``: SI and radians, g for nz; any for ``stick``, which is not converted.
    values : shape ``(N,)``; finite wherever ``valid``, zero elsewhere.
    valid : shape ``(N,)``, False where the sample is missing.
    """

    name: str
    unit: str
    values: np.ndarray
    valid: np.ndarray

    @staticmethod
    def of(name: str, unit: str, values: np.ndarray) -> Channel:
        """Return a channel from raw values in which NaN marks a missing sample."""
        raw = np.array(values, dtype=float)
        valid = np.isfinite(raw)
        return Channel(name, unit, _frozen(np.where(valid, raw, 0.0)), _frozen(valid))

    def __repr__(self) -> str:
        return f"<Channel {self.name} ({self.unit}), {self.values.size} samples>"

    def with_gaps(self) -> np.ndarray:
        """Return the values with NaN where a sample is missing, for writing and plotting only."""
        return np.where(self.valid, self.values, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """Measured signals on one time base.

    Attributes
    ----------
    time : shape ``(N,)``, s, strictly increasing; sampling may be uneven.
    inputs, outputs : channels of length N; an input has no missing sample.
    hold : behaviour of the inputs between samples.
    name : a label for messages, e.g. the file's name.

    Raises
    ------
    RecordError : the record has fewer than two samples; time is not finite or does not increase;
        lengths differ; a channel has no sample; an input misses a sample; a name occurs twice.
    """

    time: np.ndarray
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    hold: Hold = Hold.PREVIOUS
    name: str = "record"

    def __post_init__(self) -> None:
        time = np.array(self.time, dtype=float)
        if time.ndim != 1 or time.size < 2:
            raise RecordError(
                f"{time.size} sample(s)", where=self.name, remedy="a record needs at least two rows"
            )
        if not np.all(np.isfinite(time)):
            raise RecordError(
                "time is missing or infinite",
                where=f"{self.name}, row {int(np.argmin(np.isfinite(time))) + 1}",
                remedy="give every row a time",
            )
        step = np.diff(time)
        if np.any(step <= 0):
            row = int(np.argmax(step <= 0)) + 2
            what = "time is repeated" if step[row - 2] == 0 else "time goes back"
            raise RecordError(
                f"{what} ({time[row - 2]:.9g} s, then {time[row - 1]:.9g} s)",
                where=f"{self.name}, row {row}",
                remedy="sort the rows and remove duplicates",
            )
        names = [channel.name for channel in self.channels]
        for channel in self.channels:
            if channel.values.shape != time.shape or channel.valid.shape != time.shape:
                raise RecordError(
                    f"{channel.values.size} values for {time.size} times",
                    where=f"{self.name}, channel {channel.name}",
                    remedy="give each row one value",
                )
            if not np.any(channel.valid):
                raise RecordError(
                    "not a single number",
                    where=f"{self.name}, channel {channel.name}",
                    remedy="leave the column out",
                )
            if names.count(channel.name) > 1:
                raise RecordError(
                    "appears twice",
                    where=f"{self.name}, channel {channel.name}",
                    remedy="keep one of the two",
                )
        for channel in self.inputs:
            if not np.all(channel.valid):
                row = int(np.argmin(channel.valid)) + 1
                raise RecordError(
                    "an input sample is missing",
                    where=f"{self.name}, channel {channel.name}, row {row}",
                    remedy="fill the gap or cut the record there",
                )
        object.__setattr__(self, "time", _frozen(time))

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self.inputs + self.outputs

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.outputs)

    def __repr__(self) -> str:
        return (
            f"<Record {self.name}: {len(self)} samples of "
            f"{', '.join(channel.name for channel in self.channels)}>"
        )

    def __len__(self) -> int:
        return int(self.time.size)

    def __getitem__(self, name: str) -> Channel:
        for channel in self.channels:
            if channel.name == name:
                return channel
        available = ", ".join(channel.name for channel in self.channels)
        raise RecordError(
            f"there is no channel {name!r}", where=self.name, remedy=f"it has {available}"
        )

    def input_array(self, names: Iterable[str] | None = None) -> np.ndarray:
        """Return inputs as an array ``(n_inputs, N)``, in the order of ``names``; None for all."""
        chosen = self.inputs if names is None else [self[name] for name in names]
        return np.array([channel.values for channel in chosen], dtype=float).reshape(-1, len(self))

    def output_array(self, names: Iterable[str] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return outputs and whether their samples are valid, both ``(n_outputs, N)``.

        The rows are in the order of ``names``; None for all outputs. A name that the record lacks
        gives a row without a valid sample.
        """
        chosen = self.output_names if names is None else tuple(names)
        values = np.zeros((len(chosen), len(self)))
        valid = np.zeros((len(chosen), len(self)), dtype=bool)
        for row, name in enumerate(chosen):
            if name in self.output_names:
                values[row], valid[row] = self[name].values, self[name].valid
        return values, valid

    def window(self, start: float | None = None, stop: float | None = None) -> Record:
        """Return the rows with ``start <= time <= stop`` (s); None leaves that end open."""
        keep = np.ones(len(self), dtype=bool)
        if start is not None:
            keep &= self.time >= start
        if stop is not None:
            keep &= self.time <= stop
        if np.count_nonzero(keep) < 2:
            span = time_span(self.time[0], self.time[-1])
            raise RecordError(
                f"fewer than two rows between {start} and {stop} s",
                where=self.name,
                remedy=f"the record covers {span}",
            )
        return self.rows(keep)

    def rows(self, keep: np.ndarray) -> Record:
        """Return the rows where ``keep (N,)``, bool, is true."""
        cut = [
            tuple(
                replace(c, values=_frozen(c.values[keep]), valid=_frozen(c.valid[keep]))
                for c in group
            )
            for group in (self.inputs, self.outputs)
        ]
        return replace(self, time=self.time[keep], inputs=cut[0], outputs=cut[1])

    def only(self, outputs: Iterable[str]) -> Record:
        """Return the same record with only the named outputs."""
        return replace(self, outputs=tuple(self[name] for name in outputs))


def _frozen(array: np.ndarray) -> np.ndarray:
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def refuse_beyond_measure(record: Record, names: Sequence[str], largest: float) -> None:
    """Raise RecordError if a channel of ``names`` has a magnitude above ``largest``, in its SI
    unit.
    """
    for name in names:
        channel = record[name]
        wrong = np.flatnonzero(channel.valid & (np.abs(channel.values) > largest))
        if wrong.size:
            raise RecordError(
                f"{channel.values[wrong[0]]:g} is no measurement",
                where=f"{record.name}, channel {name} at {record.time[wrong[0]]:g} s",
                remedy="leave the cell empty where the sample is missing",
            )


def extent(record: Record) -> str:
    """Return samples and time of a record as a text, ``"851 samples, 0 to 17 s"``."""
    return f"{len(record)} samples, {time_span(record.time[0], record.time[-1])}"
