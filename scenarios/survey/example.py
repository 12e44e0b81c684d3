"""A survey's file to copy and edit."""

from __future__ import annotations

# Names the two records and the vehicle file that `flightid simulate trace-vane --out flight.csv` writes, so that it can be run as it stands.
EXAMPLE = """\
title = "two flights of a bomber"
model = "rigid"                    # as --model
vehicle = "flight_vehicle.toml"    # what all flights have in common; paths are relative to this file
# channels = "map.toml"            # likewise columns, from, to, maneuver, maneuvers, hold, rate, lowpass, effort, effects
# records = "flights/*.csv"        # each file a flight that needs no further word

[[flights]]
record = "flight.csv"              # or records = ["a.csv", "b.csv"], several maneuvers of one flight
name = "F001"                      # else the file's name
date = 2026-03-02
tail = "A-1"
condition = {altitude = "1500 m"}  # numbers over which derivatives are compared

[[flights]]
record = "flight_validate.csv"
name = "F002"
date = 2026-03-03
tail = "A-1"
vehicle = {mass = "2.9e5 kg"}      # takes the place of what the vehicle file says
condition = {altitude = "1500 m"}
"""
