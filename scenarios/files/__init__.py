"""The border where users' files are read and written: units, records, channel maps, vehicle files,
study folders.
"""
