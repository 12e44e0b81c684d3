"""Files of measurement systems: ASAM MDF, TDMS, HDF5 and MAT files. The rules for variables of HDF5
and MAT files are in ``variables.py``.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scenarios.files.formats.cells import (
    Reader,
    Topic,
    damaged,
    missing_library,
    no_table,
    table_of_columns,
)
from scenarios.files.formats.variables import topics_of_variables
from scenarios.files.sources import COMPRESSED_TYPE

# ---- ASAM MDF (MF4, MDF) by asammdf: each channel group is a topic with its own clock

MASTER_CHANNELS = (2, 3)  # types of channels that are the clock


def read_mdf(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for each channel group, with the name of the group or ``group 1``, ... The
    clock is ``time``, s.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise missing_library(error, path, "ASAM MDF", "recorders") from None
    topics = []
    try:
        with MDF(io.BytesIO(raw)) as log:
            for number in range(len(log.groups)):
                topic = _mdf_topic(path, log, number, _name(log, number))
                if topic is not None:
                    topics.append(topic)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "ASAM MDF") from None
    if not topics:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(topics) if len(topics) > 1 else (Topic("", topics[0].table),)


def _name(log: Any, number: int) -> str:
    return getattr(log.groups[number].channel_group, "acq_name", None) or f"group {number + 1}"


def _mdf_topic(path: Path, log: Any, number: int, name: str) -> Topic | None:
    """Return the topic of a channel group; None if the group has no channel of numbers."""
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {"time": "s"}
    for index, channel in enumerate(log.groups[number].channels):
        signal = log.get(group=number, index=index)
        if signal.samples.dtype.kind not in "fiub" or signal.samples.ndim != 1:
            continue
        columns.setdefault("time", np.asarray(signal.timestamps, dtype=float))
        if channel.channel_type in MASTER_CHANNELS:
            continue
        columns[channel.name], units[channel.name] = signal.samples, signal.unit or ""
    if len(columns) < 2:
        return None
    return Topic(name, table_of_columns(path, columns, units, place=name))


# ---- National Instruments TDMS files by npTDMS: each group is a topic


def read_tdms(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for the channels of a group with equal increments and lengths. The property
    ``unit_string`` has the units.
    """
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise missing_library(error, path, "TDMS", "recorders") from None
    topics: list[Topic] = []
    try:
        log = TdmsFile.read(io.BytesIO(raw))
        for group in log.groups():
            channels_by_clock: dict[tuple[Any, int], list[Any]] = {}
            for channel in group.channels():
                if channel[:].dtype.kind in "fiubM" and len(channel):
                    clock = (channel.properties.get("wf_increment"), len(channel))
                    channels_by_clock.setdefault(clock, []).append(channel)
            for (increment, count), channels in channels_by_clock.items():
                name = group.name
                if any(topic.name == group.name for topic in topics):
                    name = f"{group.name} {count}"
                columns = {channel.name: channel[:] for channel in channels}
                units = {
                    channel.name: str(channel.properties.get("unit_string", ""))
                    for channel in channels
                }
                has_time = any(column.lower().startswith("time") for column in columns)
                if increment and not has_time:
                    begin = float(channels[0].properties.get("wf_start_offset", 0.0))
                    columns = {"time": begin + float(increment) * np.arange(count), **columns}
                    units["time"] = "s"
                table = table_of_columns(path, columns, units, place=f"group {name}")
                topics.append(Topic(name, table))
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "TDMS") from None
    if not topics:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(topics) if len(topics) > 1 else (Topic("", topics[0].table),)


# ---- HDF5 files by h5py: a group is a struct, and a dataset is a variable in it

UNIT_ATTRIBUTES = ("units", "unit", "Unit", "Units", "UNIT", "UNITS")
# attributes with the names of the columns of a matrix
NAME_ATTRIBUTES = ("columns", "column_names", "names", "labels", "fields", "channels")


def read_hdf5(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of the file, by the rules of ``variables.py``."""
    return _hdf5_topics(path, raw, matlab=False)


def _read_new_matlab(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of a MAT file of version 7.3. Its arrays are transposed, and its texts are
    numbers.
    """
    return _hdf5_topics(path, raw, matlab=True)


def _hdf5_topics(path: Path, raw: bytes, *, matlab: bool) -> tuple[Topic, ...]:
    try:
        import h5py
    except ImportError as error:
        name = "MAT files of version 7.3" if matlab else "HDF5"
        raise missing_library(error, path, name, "recorders") from None
    try:
        with h5py.File(io.BytesIO(raw), "r") as file:
            variables = _hdf5_variables(file, file, matlab=matlab)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "MAT" if matlab else "HDF5") from None
    return topics_of_variables(path, variables)


def _hdf5_variables(group: Any, file: Any, *, matlab: bool) -> dict[str, Any]:
    """Return name -> variable of a group; inner groups are mappings of the same kind."""
    import h5py

    variables: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):  # objects of MATLAB to which references point
            continue
        if isinstance(item, h5py.Group):
            variables[name] = _hdf5_variables(item, file, matlab=matlab)
        elif isinstance(item, h5py.Dataset):
            value = _hdf5_value(item, file, matlab=matlab)
            names = next(
                (_attribute_names(item.attrs[key]) for key in NAME_ATTRIBUTES if key in item.attrs),
                (),
            )
            if np.ndim(value) == 2 and len(names) == np.shape(value)[1] > 1:
                variables[name] = {column: value[:, i] for i, column in enumerate(names)}
                continue
            unit = next(
                (_attribute_text(item.attrs[key]) for key in UNIT_ATTRIBUTES if key in item.attrs),
                "",
            )
            variables[name] = {"data": value, "units": unit} if unit else value
    return variables


def _hdf5_value(item: Any, file: Any, *, matlab: bool) -> Any:
    """Return a dataset as an array, a text, or a mapping of columns."""
    import h5py

    matlab_class = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    if item.dtype.names:  # a table with named columns, as written by pandas and PyTables
        values = item[()]
        return {name: values[name] for name in item.dtype.names}
    values = item[()]
    if h5py.check_ref_dtype(item.dtype) is not None:
        references = np.asarray(values).reshape(-1)
        # np.array would join cells of equal size to one array.
        cells = np.empty(references.size, dtype=object)
        for i, reference in enumerate(references):
            cells[i] = _hdf5_value(file[reference], file, matlab=matlab)
        return cells
    if matlab_class == b"char":
        return "".join(chr(code) for code in np.asarray(values).T.reshape(-1))
    if h5py.check_string_dtype(item.dtype) is not None:
        if not np.ndim(values):
            return _attribute_text(values)
        return np.array(
            [_attribute_text(text) for text in np.asarray(values).reshape(-1)], dtype=object
        )
    return np.asarray(values).T if matlab else np.asarray(values)


def _attribute_names(value: Any) -> tuple[str, ...]:
    """Return the names in an attribute, which is a list of texts or one text with commas."""
    if np.ndim(value) == 1:
        return tuple(_attribute_text(name).strip() for name in value)
    return tuple(name.strip() for name in _attribute_text(value).split(","))


def _attribute_text(value: Any) -> str:
    """Return a text, or the first text of an array."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(np.asarray(value).reshape(-1)[0] if np.ndim(value) else value)


# ---- MAT files of version 4 to 7.2 by SciPy, of version 7.3 by h5py

HEADER_BYTES = 128
# numbers from the description of the format by MathWorks
INT8_TYPE, UINT8_TYPE, INT32_TYPE, UINT32_TYPE, MATRIX_TYPE, UTF8_TYPE = 1, 2, 5, 6, 14, 16
TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX_TYPE, COMPRESSED_TYPE, 16, 17, 18)  # of elements
ARRAY_CLASSES = range(1, 19)
CELL_CLASS, STRUCTURE_CLASS = 1, 2
PLAIN_CLASSES = (4, *range(6, 16))  # classes of texts and numbers
READABLE_CLASSES = (CELL_CLASS, STRUCTURE_CLASS, *range(4, 16))
COMPLEX_FLAG = 0x800  # flag of an array with an imaginary part


def read_matlab(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of a MAT file of any version."""
    if raw.startswith((b"MATLAB 7.3", b"\x89HDF")):
        return _read_new_matlab(path, raw)
    from scipy.io import loadmat

    order: Literal["little", "big"] = "little" if raw[126:128] == b"IM" else "big"
    if raw.startswith(b"MATLAB 5.0") and not _known_types(raw, HEADER_BYTES, len(raw), order):
        raise damaged(ValueError("an element of no known type"), path, "MAT")
    try:
        content = loadmat(io.BytesIO(raw), simplify_cells=True)
    except NotImplementedError:
        return _read_new_matlab(path, raw)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "MAT") from None
    return topics_of_variables(
        path, {name: value for name, value in content.items() if not name.startswith("__")}
    )


def _known_types(
    raw: bytes, begin: int, end: int, order: Literal["little", "big"], *, inside: bool = False
) -> bool:
    """Return whether all elements from byte ``begin`` to ``end`` have possible types. SciPy ends
    the whole program at other types.

    Compressed elements are not tested, since they have checksums. ``inside`` is True for the
    elements of an array: flags, sizes, a name, then its content.
    """
    element_types: list[int] = []
    position, array_class, parts = begin, 0, 1
    while position + 8 <= end:
        element_type = int.from_bytes(raw[position : position + 4], order)
        # A small element has its size in the upper half, and up to four bytes within the tag.
        small_size = element_type >> 16
        size = small_size or int.from_bytes(raw[position + 4 : position + 8], order)
        element_type &= 0xFFFF if small_size else 0xFFFFFFFF
        if element_type not in TYPES or small_size > 4:
            return False
        if inside and element_type == COMPRESSED_TYPE:
            return False
        if not element_types:
            flags = int.from_bytes(raw[position + 8 : position + 12], order)
            array_class, parts = flags & 0xFF, 2 if flags & COMPLEX_FLAG else 1
        element_types.append(element_type)
        content_begin = position + 8
        if element_type == MATRIX_TYPE and not _known_types(
            raw, content_begin, min(content_begin + size, end), order, inside=True
        ):
            return False
        if small_size:
            position = content_begin
        elif element_type == COMPRESSED_TYPE:
            position = content_begin + size
        else:  # filled up to a multiple of eight bytes
            position = content_begin + (size + 7) // 8 * 8
    if not inside or not element_types:
        return True
    if position != end or array_class not in ARRAY_CLASSES:
        return False
    content = element_types[5 if array_class == STRUCTURE_CLASS else 3 :]
    if array_class in PLAIN_CLASSES and len(content) != parts:
        return False
    if array_class not in READABLE_CLASSES:
        return True
    flags_and_sizes, name = element_types[:2], element_types[2:3]
    if flags_and_sizes != [UINT32_TYPE, INT32_TYPE]:
        return False
    if not name or name[0] not in (INT8_TYPE, UINT8_TYPE, UTF8_TYPE):
        return False
    has_arrays = array_class in (CELL_CLASS, STRUCTURE_CLASS)
    return all((element_type == MATRIX_TYPE) == has_arrays for element_type in content)


READERS = (
    Reader("ASAM MDF", (".mf4", ".mdf"), (b"MDF     ", b"UnFinMF "), read_mdf),
    Reader("TDMS", (".tdms",), (b"TDSm",), read_tdms),
    Reader("HDF5", (".h5", ".hdf5", ".hdf", ".he5", ".nc4"), (b"\x89HDF\r\n\x1a\n",), read_hdf5),
    Reader("MAT", (".mat",), (b"MATLAB 5.0", b"MATLAB 7.3"), read_matlab),
)
