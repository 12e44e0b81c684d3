"""What the labs compute, without a notebook: functions of the sliders' values, which notebooks,
keys and tests share.
"""
