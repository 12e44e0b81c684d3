"""Flights whose answer is known.

They may import everything in `scenarios` but `api`, `commands` and `cli`. Only here and in
`studies` is truth opened. How often the loop is right over many flights is counted by `exam`, which
is not installed.
"""
