"""Survey of a test campaign: each flight is diagnosed and stored, then effects that recur are
found.
"""
