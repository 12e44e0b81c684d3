"""A mass on a spring and a damper whose base is shaken: what moves it is the acceleration of its
base.
"""

from sim.declaration import own_model

MODEL = own_model(
    name="shaken mass",
    states={"deflection": "m", "velocity": "m/s"},
    inputs={"base_acceleration": "m/s2"},
    outputs={"deflection": "m", "acceleration": "m/s2"},
    constants={"mass": (4.0, "kg")},
    parameters={
        "stiffness": (300.0, "N/m"),
        "damping": (18.0, "N s/m"),
    },
    flow=lambda s, p: {"felt": -(p.stiffness * s.deflection + p.damping * s.velocity) / p.mass},
    rates=lambda s, p: {"deflection": s.velocity, "velocity": s.felt - s.base_acceleration},
    readings=lambda s, p: {"deflection": s.deflection, "acceleration": s.felt},
)
