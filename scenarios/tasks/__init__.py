"""Repeated work: numbered tasks, run by one process, by many, or by a cluster.

A study has N independent tasks (runs of a campaign, surrogate flights, random cases, flights of a
fleet). Each has a number and a seed, and gives one row, which is stored when the task ends. A row
does not depend on the number of tasks or on where they run.

Imports `files` and `terminal` at most. To make something repeatable write a `Work`: its columns,
what its rows depend on, and `run` for a block of tasks. Why it is built so: [decision
24](../../docs/decisions/0024-repeated-work.md).
"""
