"""Studies side by side, from their folders alone.

Nothing is computed again: what is shown stands in a study folder, and what a study should show has
to be written there. It may import `plots`, `terminal`, `files` and `sim`. To compare one more
thing, write it into the study folders, read it in `comparison.py`, and give it a column in
`report.py`.
"""
