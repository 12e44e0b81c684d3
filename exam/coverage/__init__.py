"""Campaigns of every scenario that has parameters to estimate: writes
`docs/campaign-statistics.md`.
"""
