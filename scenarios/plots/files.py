"""Figures as bytes and files, the same for the same figure: no date, no program version."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def figure_png(figure: Figure) -> bytes:
    """The figure as a PNG at its own size and resolution."""
    buffer = io.BytesIO()
    # None takes the entry out that names matplotlib's version.
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def save_figure(figure: Figure, folder: Path, stem: str) -> Path:
    """Write ``folder/stem.png`` and return its path; the folder must exist."""
    path = Path(folder) / f"{stem}.png"
    path.write_bytes(figure_png(figure))
    return path
