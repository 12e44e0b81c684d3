"""Scenarios of the closed loop: flown as an augmented aircraft, estimated as a low-order equivalent
system (NASA TM-101722).
"""
