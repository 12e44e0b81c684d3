"""Repeated work: numbered tasks with seeds of their own, run by one process, by many, or by a
cluster, and kept as they end.

A study of N independent tasks (runs of a campaign, surrogate flights, random cases, flights of a
fleet): each has a number, a seed of its own and gives one row. Nothing in a row depends on how many
tasks there are or who runs them.

Imports `files` and `terminal` at most. To make something repeatable write a `Work`: its columns,
what its rows depend on, and `run` for a block of tasks. Why it is built so: [decision
24](../../docs/decisions/0024-repeated-work.md).
"""
