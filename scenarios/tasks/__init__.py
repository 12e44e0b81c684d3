"""Repeated work: numbered tasks, run in one process, in several, or on a cluster.

A study has N independent tasks (runs of a campaign, surrogate flights, random cases, flights of a
fleet). Each has a number and a seed, and gives one row, which is stored when the task ends. A row
does not depend on the number of tasks or on where they run.

This package imports `files` and `terminal` at most. To repeat a computation, write a `Work`: its
columns, the data on which its rows depend, and `run` for a block of tasks. [Decision
24](../../docs/decisions/0024-repeated-work.md) gives the reasons of the design.
"""
