"""Channel maps: both spellings, and faults told by file and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenarios.files.declarations import ColumnChoice, read_channel_map
from sim.errors import DeclarationError


def test_both_spellings(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('alpha = {column = "AoA1", unit = "deg"}\nq = "gyro"\ntime = {column = "T"}\n')
    assert read_channel_map(path) == {
        "alpha": ColumnChoice("AoA1", "deg"),
        "q": ColumnChoice("gyro"),
        "time": ColumnChoice("T"),
    }


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('alhpa = "AoA1"', ("key alhpa", "no such key", "did you mean 'alpha'?")),
        ('zzz = "AoA1"', ("key zzz", "no such key", "use one of time, elevator, stick, alpha")),
        ('alpha = {colum = "AoA1"}', ("key alpha.colum", "did you mean 'column'?")),
        ('alpha = {unit = "deg"}', ("key alpha", "neither column nor sum", "column =")),
        ('"al\\npha" = "AoA1"', (r"key 'al\npha'", "did you mean 'alpha'?")),
        ("alpha = true", ("key alpha", "True names no column", "{column =")),
        ("alpha = {column = 0}", ("key alpha.column", "value 0")),
        ('alpha = {column = "a", sum = ["b"]}', ("key alpha", "neither column nor sum, or both")),
        (
            'alpha = {column = "a", table = [[1.0, 0.0], [2.0, 3.0]]}',
            ("key alpha", "no calibration", "increasing"),
        ),
        ('alpha = {column = "a", sign = 2}', ("key alpha.sign", "value 2")),
        ('alpha = {column = "a", scale = inf}', ("key alpha.scale", "not a finite number")),
        ('alpha = ""', ("key alpha.column", "value ''")),
        ('alpha = {column = "a", unit = 1}', ("key alpha.unit", "value 1")),
        ("alpha = ", ("not valid TOML", "line 1")),
    ],
)
def test_faults(tmp_path: Path, text: str, parts: tuple[str, ...]) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text + "\n")
    with pytest.raises(DeclarationError) as caught:
        read_channel_map(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path)) and len(caught.value.remedy) > 4
    for part in parts:
        assert part in message, message
