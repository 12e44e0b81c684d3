"""What a record says of itself to whatever converts or draws it."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from scenarios.files.measured.record_file import RecordFile


class Recorded(Protocol):
    """Channels in SI by name, their units, and which of them are inputs."""

    @property
    def file(self) -> RecordFile: ...
    @property
    def name(self) -> str: ...
    @property
    def hold(self) -> str: ...
    @property
    def time(self) -> np.ndarray: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> dict[str, str]: ...
    @property
    def input_names(self) -> tuple[str, ...]: ...
    @property
    def output_names(self) -> tuple[str, ...]: ...
    def __getitem__(self, name: str, /) -> np.ndarray: ...
