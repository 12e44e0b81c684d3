"""The machine and the versions that times belong to."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

PACKAGES = ("flightid", "numpy", "scipy", "filterpy", "control", "dynamax", "jax", "aeroid")


def machine() -> dict[str, str]:
    """What a reader needs to compare: processor, cores, system, Python, versions, compiler, load
    and date.
    """
    return {
        "processor": _processor(),
        "cores": str(
            len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        ),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
        "C compiler": _compiler(),
        "load before": f"{os.getloadavg()[0]:.1f}",
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
        platform.processor() or "unknown",
    )


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _compiler() -> str:
    command = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if command is None:
        return "none"
    said = subprocess.run(
        [command, "--version"], capture_output=True, text=True, check=False
    ).stdout.splitlines()
    return said[0] if said else command
