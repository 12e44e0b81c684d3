"""What holds for every test: Ctrl-C is heard, one BLAS thread, the same hypothesis examples on
every run, no lines of progress however slow it is.
"""

from __future__ import annotations

import os
import signal

from hypothesis import settings

from scenarios.report import progress

# Set before any test imports numpy; small matrices gain nothing from threads, and processes inherit
# it.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# As at a terminal: a shell that starts something in the background has it ignored, also by what
# that starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("flightid", deadline=None, derandomize=True)
settings.load_profile("flightid")
progress.EVERY = 1e6  # s; a command's stderr is empty on a busy machine, too
