"""Reading and writing of users' files: units, records, channel maps, vehicle files, folders of
studies.
"""
