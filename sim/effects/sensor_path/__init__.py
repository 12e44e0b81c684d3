"""Effects between the vehicle and the record, one file for an effect or a family: `read(s, y,
vehicle, p)` without memory, `act(steps, begin, end, p)` with it, `pace(p)` of the record's clock.

May import `sim.declaration`, `sim.maths` and the shared files of `sim/effects`; no other effect.
Two descriptions of one fault of one sensor name each other as `twins`.
"""
