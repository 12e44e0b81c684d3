"""Names of the rigid short period's constants, derivatives and outputs, in the order of a problem's
arrays.
"""

CONSTANTS = ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
DERIVATIVES = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
OUTPUTS = ("alpha", "q")
