"""Scenarios of the closed loop: simulated as an augmented aircraft, estimated as a low-order
equivalent system (NASA TM-101722).
"""
