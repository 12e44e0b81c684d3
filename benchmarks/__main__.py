"""`python -m benchmarks`: flightid beside its peers, written to docs/performance.md."""

import sys

from benchmarks.comparison.command import main

sys.exit(main())
