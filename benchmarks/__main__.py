"""`python -m benchmarks`: flightid beside its peers, written to docs/performance.md."""

import signal
import sys

from benchmarks.comparison.command import main

# also where it was started in the background
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.default_int_handler)
sys.exit(main())
