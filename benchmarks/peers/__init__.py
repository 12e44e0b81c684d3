"""The same work by flightid and by others, each in a file of its own that imports nothing of the
others.
"""
