"""Writes the simulated logs of docs/how-to/your-recorder.md: `python -m tests.recorders FOLDER`."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.recorders import flights, quadrotor


def main(arguments: list[str]) -> None:
    if len(arguments) != 1:
        sys.exit("usage: python -m tests.recorders FOLDER")
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    quadrotor.write_all(folder)
    try:
        flights.write_all(folder)
    except ImportError as error:
        print(
            f"not all files are written: {error.name} is not installed; "
            'python -m pip install -e ".[formats]"'
        )
    names = sorted(path.name for path in folder.iterdir())
    print(f"{folder}: {', '.join(names)}")


if __name__ == "__main__":
    main(sys.argv[1:])
