"""Records to and from the containers of other packages, each imported when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.api.recorded import Recorded
from scenarios.api.records.in_memory import columns_of_frame, columns_of_record
from scenarios.files.channel_names import TIME, split_header
from sim.errors import RecordError
from sim.record import Record as SimRecord

if TYPE_CHECKING:
    import control
    import pandas
    import xarray


@dataclass(frozen=True)
class Told:
    """What a container says of a record besides its numbers; None and empty where it does not say.

    ``unreadable``: names of variables that are not one value a sample, and why.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    name: str | None = None
    hold: str | None = None
    inputs: tuple[str, ...] | None = None
    unreadable: Mapping[str, str] = field(default_factory=dict)


def unpacked(source: Any) -> tuple[Path | Mapping[str, Any], Told]:
    """A path, or columns by name, and what the container says of them.

    Raises
    ------
    RecordError : it is nothing that holds a record.
    """
    if isinstance(source, str | PathLike):
        return Path(source), Told()
    if isinstance(source, SimRecord):
        columns, units = columns_of_record(source)
        return columns, Told(units, source.name, source.hold.value, source.input_names)
    if isinstance(source, Mapping) and not hasattr(source, "data_vars"):
        return source, Told()
    kind = {each.__name__ for each in type(source).__mro__}
    if "TimeResponseData" in kind:
        return _of_response(source)
    if "Dataset" in kind and hasattr(source, "data_vars"):
        return _of_dataset(source)
    if isinstance(source, np.ndarray) and source.dtype.names:
        return {name: source[name] for name in source.dtype.names}, Told()
    if "DataFrame" not in kind or not hasattr(source, "iloc"):
        if not hasattr(source, "to_pandas"):
            what = f"a {type(source).__name__} is no record"
            raise RecordError(what, where="read_record", remedy="give a path, a DataFrame, a mapping of names to arrays, a Dataset or a response")
        source = source.to_pandas()
    return columns_of_frame(source), _of_attributes(source.attrs)


def _of_attributes(attributes: Mapping[str, Any]) -> Told:
    """What ``to_pandas`` and ``to_xarray`` put down; other people's attributes are left alone."""
    units, name, hold, inputs = (attributes.get(key) for key in ("units", "name", "hold", "inputs"))
    return Told(
        {str(key): str(value) for key, value in units.items()} if isinstance(units, Mapping) else {},
        name if isinstance(name, str) else None,
        hold if hold in ("previous", "linear") else None,
        tuple(map(str, inputs)) if isinstance(inputs, tuple | list) else None,
    )


def _attributes(record: Recorded) -> dict[str, Any]:
    said = {"hold": record.hold} if record.file.sidecar.says_hold else {}
    return {"name": record.name, **said, "inputs": list(record.input_names)}


def to_pandas(record: Recorded) -> pandas.DataFrame:
    """Channels in SI over the index ``time``, s."""
    import pandas

    frame = pandas.DataFrame({name: record[name] for name in record.names}, index=pandas.Index(record.time, name=TIME))
    frame.attrs = {**_attributes(record), "units": {TIME: "s", **record.units}}
    return frame


def to_xarray(record: Recorded) -> xarray.Dataset:
    """Channels in SI over the coordinate ``time``, units as attributes. Raises ImportError where xarray is not installed."""
    try:
        import xarray
    except ImportError:
        raise ImportError("to_xarray needs xarray, which is not installed: python -m pip install xarray") from None
    data = {name: (TIME, record[name], {"units": record.units[name]}) for name in record.names}
    return xarray.Dataset(data, {TIME: (TIME, record.time, {"units": "s"})}, _attributes(record))


def to_control(record: Recorded) -> control.TimeResponseData:
    """The record as python-control's response: outputs ``(m, N)`` and inputs with labels; NaN where a sample is missing."""
    import control

    inputs, outputs = record.input_names, record.output_names
    if not outputs:
        raise RecordError("it has inputs alone", where=record.name, remedy="name fewer of its channels as inputs")
    rows = np.array([record[name] for name in inputs]) if inputs else None
    return control.TimeResponseData(
        record.time,
        np.array([record[name] for name in outputs]),
        inputs=rows,
        output_labels=list(outputs),
        input_labels=list(inputs) if inputs else None,
        issiso=False,
        title=record.name,
    )


def _of_response(response: control.TimeResponseData) -> tuple[Mapping[str, Any], Told]:
    outputs, inputs = np.atleast_2d(response.y), np.atleast_2d(response.u) if response.u is not None else np.zeros((0, len(response.time)))
    if outputs.ndim != 2 or inputs.ndim != 2:
        raise RecordError("it holds several traces", where="read_record", remedy="give one of them, for example response[:, 0]")
    names = list(response.output_labels or [f"y[{i}]" for i in range(len(outputs))])
    controls = list(response.input_labels or [f"u[{i}]" for i in range(len(inputs))])[: len(inputs)]
    columns = {TIME: response.time, **dict(zip(controls, inputs, strict=True)), **dict(zip(names, outputs, strict=True))}
    return columns, Told(name=response.title or None, inputs=tuple(split_header(name)[0] for name in controls))


def _of_dataset(dataset: xarray.Dataset) -> tuple[Mapping[str, Any], Told]:
    along = dataset[TIME].dims if TIME in dataset.variables else None
    every = {str(name): dataset[name] for name in (*dataset.coords, *dataset.data_vars)}
    variables = {name: each for name, each in every.items() if each.dims == along or along is None}
    others = {
        name: f"over {', '.join(map(str, each.dims))}, not over {', '.join(map(str, along or ()))}" if each.dims else "a single number"
        for name, each in every.items()
        if name not in variables
    }
    told = _of_attributes(dataset.attrs)
    units = {name: str(each.attrs["units"]) for name, each in variables.items() if "units" in each.attrs}
    columns = {name: each.to_numpy() for name, each in variables.items()}
    return columns, Told({**told.units, **units}, told.name, told.hold, told.inputs, others)
