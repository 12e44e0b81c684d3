"""Records in Python: read from files and objects, and passed on to other packages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.api import tables
from scenarios.api.records import (
    INPUTS,
    ChannelColumn,
    ChannelMap,
    Units,
    columns_of,
    columns_of_record,
    digest_of,
    file_of_columns,
    named_inputs,
    opened_source,
    refuse_misread,
    refuse_unreadable,
)
from scenarios.api.tables import in_python
from scenarios.files.declarations import CHANNEL_UNITS, TIME
from scenarios.files.measured.columns import RecordFile
from scenarios.files.records import refuse_without_clock, window_of
from scenarios.files.sources import InputFile
from sim import record as sim_record
from sim.errors import RecordError, instant, time_span
from sim.record import Hold

if TYPE_CHECKING:
    import control
    import pandas
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """Measured signals on one time base.

    ``record["alpha"]`` is a channel in SI and radians, NaN if a sample is missing; ``time`` is in
    s. Channels are found by their names and units as in files (``alpha``, ``alpha_deg``, ``q
    [deg/s]``). Columns that are no known channel keep their names and numbers. Values are converted
    when they are requested.

    Attributes
    ----------
    file : the content with its name, units and channel map.
    """

    file: RecordFile
    _inputs: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """Name of the record in messages."""
        return self.file.identity.name

    @property
    def hold(self) -> str:
        """Behaviour of the inputs between samples: ``"previous"`` or ``"linear"``."""
        return self.file.sidecar.hold.value

    @cached_property
    def _columns(self) -> dict[str, ChannelColumn]:
        return columns_of(self.file)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels without the time."""
        return tuple(self._columns)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel's values."""
        return {name: column.unit for name, column in self._columns.items()}

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the channels that are controls, or were named as inputs."""
        chosen = INPUTS if self._inputs is None else self._inputs
        return tuple(name for name in self.names if name in chosen)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of all channels but the controls."""
        return tuple(name for name in self.names if name not in self.input_names)

    @cached_property
    def time(self) -> np.ndarray:
        """Time stamps, s, shape ``(N,)``. Raises InputError if they do not increase or one is
        missing.
        """
        return window_of(self.file)[0]

    def __getitem__(self, name: str) -> np.ndarray:
        if name == TIME:
            return self.time
        # With a map or unit that does not fit the column, its raw values are not the channel.
        if name in self._columns or name in self.file.choices:
            refuse_misread(self.file, name)
        if name not in self._columns:
            refuse_unreadable(self.file, name)
            raise RecordError(
                f"there is no channel {name!r}",
                where=self.name,
                remedy=f"it has {', '.join(self._columns)}",
            )
        return self._columns[name].values()

    def __contains__(self, name: object) -> bool:
        return name in self._columns or name == TIME

    def __len__(self) -> int:
        return int(self.file.table.rows.size)

    def __repr__(self) -> str:
        shown = ", ".join(self.names[:8]) + (", ..." if len(self.names) > 8 else "")
        return f"<Record {self.name}: {len(self)} samples of {shown}>"

    def _repr_html_(self) -> str:
        try:
            span = f"{len(self)} samples, {time_span(self.time[0], self.time[-1])}"
        except RecordError as error:
            span = str(error)
        rows = [[name, self.units[name], *self._span_of(name)] for name in self.names]
        return tables.page(
            f"{self.name}: {span}",
            tables.table(("channel", "unit", "least", "most", "missing"), rows, left=2),
        )

    def _span_of(self, name: str) -> list[str]:
        """Return smallest and largest value and number of missing ones, or the error."""
        try:
            values = self[name]
        except RecordError as error:
            return [str(error), "", ""]
        known = values[np.isfinite(values)]
        ends = [f"{known.min():.4g}", f"{known.max():.4g}"] if known.size else ["-", "-"]
        return [*ends, str(values.size - known.size)]

    def window(self, start: float | None = None, stop: float | None = None) -> Record:
        """Return the rows from ``start`` to ``stop`` (s, both included) as a record.

        None leaves that end open. Raises InputError if there is no such row.
        """
        with in_python():
            return replace(self, file=rows_of_file(self.file, start, stop))

    def resample(self, rate: float) -> Record:
        """Return the record at a lower rate, after a zero-phase low-pass at 0.4 times that rate.

        Parameters
        ----------
        rate : samples a second.

        Returns
        -------
        Record
            In SI; its inputs are linear between samples.

        Raises
        ------
        InputError
            The rate is above the record's, or leaves too little of it.

        Examples
        --------
        >>> import flightid as fid
        >>> record = fid.simulate("rigid", seed=3).record
        >>> len(record), len(record.resample(20.0))
        (801, 161)
        """
        return self._filtered(rate=rate)

    def lowpass(self, corner: float) -> Record:
        """Return the record after one zero-phase Butterworth low-pass, the same for all channels.

        Parameters
        ----------
        corner : Hz, below half the record's rate.

        Raises
        ------
        InputError
            The corner is not below half the rate, or leaves nothing of the record.
        """
        return self._filtered(lowpass=corner)

    def with_hold(self, hold: str) -> Record:
        """Return the record with another behaviour of its inputs between samples.

        Parameters
        ----------
        hold : ``"previous"`` (held until the next sample) or ``"linear"``.

        Examples
        --------
        >>> import flightid as fid
        >>> fid.simulate("rigid", seed=3).record.with_hold("linear").hold
        'linear'
        """
        kinds = [each.value for each in Hold]
        if hold not in kinds:
            raise RecordError(
                f"there is no hold {hold!r}", where=self.name, remedy=f"use {' or '.join(kinds)}"
            )
        sidecar = replace(self.file.sidecar, hold=Hold(hold), states_hold=True)
        return replace(self, file=replace(self.file, sidecar=sidecar))

    def _filtered(self, rate: float | None = None, lowpass: float | None = None) -> Record:
        from scenarios.preparation.filtering import filtered
        from scenarios.preparation.plan import plan_of

        def channels(names: tuple[str, ...]) -> tuple[sim_record.Channel, ...]:
            return tuple(
                sim_record.Channel.of(name, self.units[name], self[name]) for name in names
            )

        whole = sim_record.Record(
            self.time,
            channels(self.input_names),
            channels(self.output_names),
            Hold(self.hold),
            self.name,
        )
        with in_python():
            done, _ = filtered(whole, plan_of(rate=rate, lowpass=lowpass))
        return record_of(done)

    def plot(self) -> Figure:
        """Plot inputs and outputs against time, angles in degrees."""
        from scenarios.api import plot

        return plot.record(self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a DataFrame over ``time`` (s); units, name, hold and inputs are in ``attrs``."""
        import pandas

        frame = pandas.DataFrame(
            {name: self[name] for name in self.names}, index=pandas.Index(self.time, name=TIME)
        )
        frame.attrs = {**self._attributes, "units": {TIME: "s", **self.units}}
        return frame

    @property
    def _attributes(self) -> dict[str, Any]:
        stated_hold = {"hold": self.hold} if self.file.sidecar.states_hold else {}
        return {"name": self.name, **stated_hold, "inputs": list(self.input_names)}

    @staticmethod
    def from_pandas(frame: pandas.DataFrame, **options: Any) -> Record:
        """Return ``read_record`` of a DataFrame, with the metadata in its ``attrs``."""
        return read_record(frame, **options)

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset over ``time``; variables have units as attributes. Needs xarray."""
        try:
            import xarray
        except ImportError:
            raise ImportError(
                "to_xarray needs xarray, which is not installed: python -m pip install xarray"
            ) from None
        data = {name: (TIME, self[name], {"units": self.units[name]}) for name in self.names}
        return xarray.Dataset(data, {TIME: (TIME, self.time, {"units": "s"})}, self._attributes)

    @staticmethod
    def from_xarray(dataset: xarray.Dataset, **options: Any) -> Record:
        """Return ``read_record`` of a Dataset, with the attributes ``units`` of its variables."""
        return read_record(dataset, **options)

    def to_control(self) -> control.TimeResponseData:
        """Return a response for python-control with named inputs and outputs, SI."""
        import control

        inputs, outputs = self.input_names, self.output_names
        if not outputs:
            raise RecordError(
                "it has inputs alone",
                where=self.name,
                remedy="name fewer of its channels as inputs",
            )
        return control.TimeResponseData(
            self.time,
            np.array([self[name] for name in outputs]),
            inputs=np.array([self[name] for name in inputs]) if inputs else None,
            output_labels=list(outputs),
            input_labels=list(inputs) if inputs else None,
            issiso=False,
            title=self.name,
        )

    @staticmethod
    def from_control(response: control.TimeResponseData, **options: Any) -> Record:
        """Return ``read_record`` of a response, with the names of its labels."""
        return read_record(response, **options)


def read_record(
    source: str | PathLike[str] | Mapping[str, Any] | Any,
    *,
    units: Units | None = None,
    channels: ChannelMap | None = None,
    inputs: str | Iterable[str] | None = None,
    hold: str | None = None,
    name: str | None = None,
) -> Record:
    """Return a record from a file, a DataFrame, named arrays, an xarray Dataset or a python-control
    response.

    Parameters
    ----------
    source : path of a file of any format that ``flightid map`` reads; a DataFrame, whose time is a
        column ``time`` or its index (datetimes, timedeltas, or an index named time); a mapping of
        names to arrays, or a structured array; a Dataset; a TimeResponseData; a record.
    units : unit by channel or column whose name has no unit, ``{"alpha": "deg"}``.
    channels : column by channel, ``{"alpha": "AoA1"}`` or ``{"alpha": ("AoA1", "deg")}``; or the
        path of a channel map.
    inputs : names of the controls; None: elevator, stick, aileron, rudder and thrust.
    hold : behaviour of inputs between samples, ``"previous"`` or ``"linear"``; None: that of the
        sidecar or of the data.
    name : name in messages of a record in memory; a file has its own.

    Raises
    ------
    InputError : the source is no record or has no time, or a channel or unit does not fit.

    Examples
    --------
    >>> import numpy as np
    >>> import flightid as fid
    >>> time = np.arange(0.0, 1.0, 0.1)
    >>> columns = {"time": time, "AoA": 2.0 * np.sin(time)}
    >>> fid.read_record(columns, channels={"alpha": ("AoA", "deg")}, name="flight 1")
    <Record flight 1: 10 samples of alpha>
    """
    if isinstance(source, Record):
        return source
    refuse_misspelt(channels, "record" if name is None else name)
    file, named = opened_source(source, units=units, channels=channels, hold=hold, name=name)
    refuse_without_clock(file)
    record = Record(file, named)
    if inputs is None:
        return record
    return replace(record, _inputs=named_inputs(inputs, record.names, record.name))


def record_of(record: sim_record.Record) -> Record:
    """Return an internal record as a record of the Python interface, in SI."""
    columns, units = columns_of_record(record)
    return Record(file_of_columns(columns, record.name, units, record.hold), record.input_names)


def rows_of_file(file: RecordFile, start: float | None, stop: float | None) -> RecordFile:
    """Return the rows of a record file between two times, s, which its name then has.

    Row numbers stay those of the file. Raises RecordError if there is no such row.
    """
    time, rows = window_of(file, start, stop)
    ends = (time[0] if start is None else start, time[-1] if stop is None else stop)
    span = f"{instant(ends[0], 6)}-{instant(ends[1], 6)} s"
    label = f"{file.identity.name}[{span}]"
    old = file.table
    ragged = {
        position - rows.start: cells
        for position, cells in old.ragged.items()
        if rows.start <= position < rows.stop
    }
    table = replace(
        old,
        file=label,
        columns=tuple(column[rows] for column in old.columns),
        rows=old.rows[rows],
        ragged=ragged,
    )
    return replace(
        file,
        path=Path(label),
        table=table,
        identity=InputFile(label, digest_of(table)),
        in_memory=True,
    )


def refuse_misspelt(channels: Any, where: str) -> None:
    """Raise RecordError for a known channel with a missing, surplus or misplaced letter.

    Any other name may be a channel of a user model.
    """
    for name in channels if isinstance(channels, Mapping) else ():
        if not isinstance(name, str) or name in CHANNEL_UNITS or not name.isalpha():
            continue
        near = difflib.get_close_matches(name, CHANNEL_UNITS, n=1, cutoff=0.8)
        if near and (abs(len(near[0]) - len(name)) == 1 or sorted(near[0]) == sorted(name)):
            raise RecordError(
                f"there is no channel {name!r}",
                where=f"{where}, channels",
                remedy=f"did you mean {near[0]!r}?",
            )
