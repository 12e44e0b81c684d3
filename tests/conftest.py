"""What holds for every test: Ctrl-C is heard, one BLAS thread, the same hypothesis examples on
every run, no lines of progress however slow it is. Of a test marked ``sampled`` all cases but the
first are long ones.
"""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import settings

from scenarios.report import terminal

# Set before any test imports numpy; small matrices gain nothing from threads, and processes inherit
# it.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# As at a terminal: a shell that starts something in the background has it ignored, also by what
# that starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("flightid", deadline=None, derandomize=True)
settings.load_profile("flightid")
terminal.PLAIN_LINE_INTERVAL = 1e6  # s; a command's stderr is empty on a busy machine, too


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All cases but the first of a test marked ``sampled`` are long ones."""
    seen: set[str] = set()
    for item in items:
        if item.get_closest_marker("sampled") is None:
            continue
        test = item.nodeid.partition("[")[0]
        if test in seen:
            item.add_marker(pytest.mark.long)
        seen.add(test)
