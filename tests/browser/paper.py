"""What a printed page holds."""

from __future__ import annotations

import subprocess
from pathlib import Path


def words_of(path: Path) -> list[int]:
    """Words on each page of a PDF."""
    return [len(text.split()) for text in texts_of(path)]


def texts_of(path: Path) -> list[str]:
    """The text of each page of a PDF."""
    told = subprocess.run(["pdfinfo", path], check=True, capture_output=True, text=True).stdout
    count = int(told.partition("Pages:")[2].split()[0])
    asked = (
        ["pdftotext", "-f", str(number), "-l", str(number), str(path), "-"]
        for number in range(1, count + 1)
    )
    printed = (subprocess.run(each, check=True, capture_output=True, text=True) for each in asked)
    return [each.stdout for each in printed]
