"""Drafts of vehicle files: numbers that a record gives, all others as comments."""

from __future__ import annotations

from scenarios.preparation.drafting import Draft, quoted


def vehicle_text(draft: Draft) -> str:
    """A draft of the vehicle file for the model that the channels fit; the numbers that the record
    does not have stand as comments.
    """
    model = draft.model or "rigid"
    if model == "ballistic":
        return _BALLISTIC.format(name=quoted(draft.file.path.stem))
    if model == "multirotor":
        return _MULTIROTOR.format(name=quoted(draft.file.path.stem))
    speed = next(
        (
            0.5 * (guess.least + guess.most)
            for guess in draft.guesses
            if guess.channel == "airspeed" and not guess.fault
        ),
        None,
    )
    key = "reference_airspeed" if model == "longitudinal" else "airspeed"
    known = (
        f"{key} = {speed:.4g}  # m/s, the middle of the recorded range"
        if speed
        else f"# {key} = ...  # m/s"
    )
    lengths = ["span"] if model == "lateral" else ["chord"]
    inertias = (
        ["roll_inertia", "yaw_inertia", "cross_inertia"]
        if model == "lateral"
        else ["pitch_inertia"]
    )
    more = {
        "lateral": ["trim_alpha  # rad", "trim_theta  # rad"],
        "longitudinal": ["thrust_arm  # m, above the centre of gravity"],
    }.get(model, [])
    lines = [
        f"# Draft of a vehicle file for --model {model}. Take the # from each line and give its "
        "number.",
        f"name = {quoted(draft.file.path.stem)}",
        '# aircraft_class = ...  # "I" light, "II" medium, "III" large, "IV" fighter (MIL-F-8785C)',
        '# flight_phase = ...  # "A" rapid maneuvers, "B" gradual ones, "C" approach and landing',
        '# mass = ...  # kg, or a text with a unit: mass = "24200 lb"',
        "# wing_area = ...  # m2",
        *(f"# {name} = ...  # m" for name in lengths),
        *(f"# {name} = ...  # kg m2" for name in inertias),
        known,
        "# air_density = ...  # kg/m3 at the height of the flight",
        *(f"# {line.split('  ')[0]} = ...  {line.split('  ')[1]}" for line in more),
        "[derivatives]  # where the search starts; 30 % wrong will do",
    ]
    return "\n".join([*lines, *(f"# {name} = ..." for name in _DERIVATIVES[model])]) + "\n"


_BALLISTIC = """# Draft of a vehicle file for --model ballistic. Take the # from each line and give its number.
name = {name}
# air_density_reference = ...  # kg/m3 at altitude 0; 1.225 at sea level
# density_scale_height = ...  # m; 8500 near the ground
gravity = 9.80665  # m/s2
[derivatives]  # where the search starts
# beta = ...  # kg/m2: mass / (drag coefficient * area)
"""  # noqa: E501
_MULTIROTOR = """# Draft of a vehicle file for --model multirotor: usual sizes for commands from -1 to 1.
name = {name}
[derivatives]  # where the search starts; what is left out is held at zero
L_p = -1.0  # 1/s, roll damping
L_lat = 60.0  # rad/s2, roll acceleration at full command
L_0 = 0.0  # rad/s2, that a steady command balances
M_q = -1.0
M_lon = 60.0
M_0 = 0.0
N_r = -0.5
N_ped = 10.0
N_0 = 0.0
Z_col = -20.0  # m/s2, specific force (down) at full thrust
Z_0 = 0.0
motor_time_constant = 0.04  # s
delay = 0.01  # s, from command to motor
"""  # noqa: E501
_DERIVATIVES = {
    "rigid": ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"),
    "longitudinal": (
        "CD_0", "CD_V", "CD_alpha", "CL_0", "CL_V", "CL_alpha", "CL_q", "CL_de", "Cm_0", "Cm_V", "Cm_alpha", "Cm_q", "Cm_de",  # noqa: E501
    ),
    "lateral": (
        "CY_beta", "CY_p", "CY_r", "CY_da", "CY_dr", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr", "Cn_beta", "Cn_p", "Cn_r", "Cn_da", "Cn_dr",  # noqa: E501
    ),
}  # fmt: skip
