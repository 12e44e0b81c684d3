"""Runs of a scenario as tasks: the same flight with a seed a run, estimated by one method."""
