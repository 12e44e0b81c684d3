"""One contender once, from a cold start: `python -m benchmarks.peers NAME PROBLEM.npz`. Imports
only what that contender needs.
"""

import sys
from importlib import import_module

import numpy as np

name, path = sys.argv[1:]
with np.load(path) as file:
    problem = dict(file)
import_module(f"benchmarks.peers.{name}").prepare(problem)()
