"""Which processes a process has begun, as Linux tells."""

from __future__ import annotations

from pathlib import Path


def below(process: int) -> list[int]:
    """Processes under one, at any depth."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            child = int(entry.parent.name)
            found += [child, *below(child)]
    return found
