"""Work of the commands that consists of many lines, one file a family: libraries, studies, streams.

It may import everything in `scenarios` but `cli`. The options are in `scenarios/cli`.
"""
