"""Models that leave the tool: written as a Python module, for JSBSim, in DAVE-ML, as an FMU."""
