"""Tables 1 to 5 of the paper on simulated flight data, typed a second time as it prints them, and
the starts that its scenarios declare.
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal

# A row a line: name, then value and standard deviation of each column. Copied from the paper, not
# from the project's file.
TABLES = {
    "ballistic": """
        -         two_terms          three_terms        process_noise_two_terms  process_noise_three_terms
        beta      497.8827 0.290904  499.8196 0.290046  488.9278 11.07214        488.7636 11.23639
    """,  # noqa: E501
    "rigid": """
        -         none               case_a             case_b
        CL_alpha  2.9096   0.00764   2.8772   0.06228   2.8887   0.08767
        CL_q      -22.7217 0.75708   -16.6971 1.78776   -16.8602 1.89439
        CL_de     0.6756   0.01976   -0.3212  0.13688   -0.2328  0.14417
        Cm_alpha  -1.6078  0.00166   -1.8501  0.03303   -1.6099  0.0784
        Cm_q      -38.3583 6.68809   -39.0636 6.9463    -41.527  6.94662
        Cm_de     -2.25619 0.00289   -2.7122  0.10493   -2.8064  0.0588
    """,
    "rigid_equivalent": """
        -         ac1                ac2
        CL_alpha  2.4927   0.006445  1.7955   0.017004
        CL_q      -1.5588  0.6973    -7.7374  2.56618
        CL_de     0.9644   0.0179    -0.2195  0.06234
        Cm_alpha  -1.3141  0.0012    -0.4582  0.001378
        Cm_q      -20.6907 6.6134    -15.2807 6.932
        Cm_de     -2.2514  0.00271   -1.5197  0.00752
    """,
    "first_mode": """
        -              ac1                ac2
        CL_alpha       3.2861    0.0445   3.0798    0.03598
        CL_q           -13.2036  1.02     -24.6586  1.7327
        CL_de          0.8184    0.0312   0.2619    0.03821
        Cm_alpha       -1.6082   0.0084   -1.8725   0.01857
        Cm_q           -32.4563  0.2808   -41.1266  0.49461
        Cm_de          -2.565    0.0145   -2.1175   0.01376
        CL_eta1        0.0556    0.0024   0.012     0.000479
        CL_etadot1     0.0905    0.0163   0.1792    0.01244
        Cm_eta1        -0.0411   0.0025   -0.0201   0.000129
        Cm_etadot1     -0.0799   0.022    -0.1873   0.00451
        Ceta1_alpha    -0.017    0.0018   -0.0244   0.000281
        Ceta1_q        -0.1      0.0186   -0.0672   0.009936
        Ceta1_eta1     0.00062   0.0001   0.000126  0.000002
        Ceta1_etadot1  -0.000587 0.00007  -0.000842 0.000027
        Ceta1_de       -0.0127   0.0012   -0.009864 0.000217
    """,
}

# The true values of the same tables, by vehicle.
TRUE = {
    "ballistic_target": "beta 500 lb/ft2, altitude 200000 ft, velocity -6000 ft/s",
    "bomber_rigid": (
        "CL_alpha 2.922, CL_q -14.7, CL_de 0.435, Cm_alpha -1.66, Cm_q -34.75, Cm_de -2.578"
    ),
    "bomber_ac1": "CL_eta1 0.0288, CL_etadot1 0.0848, Cm_eta1 0.0025, Cm_etadot1 -0.159, Ceta1_alpha -0.014898, Ceta1_q -0.0949, "  # noqa: E501
    "Ceta1_eta1 0.0000585, Ceta1_etadot1 -0.00042, Ceta1_de -0.012835",
}

# What the scenarios start from: name, value, standard deviation (the root of P0), with their units
# where they have one.
_REST = "alpha 0 | 0.5 deg, q 0 | 0.5 deg/s"
_FALL = "altitude 200025 ft | 25 ft, velocity -6150 ft/s | 150 ft/s"
_HANDBOOK = (
    "CL_alpha 3.4 | 1, CL_q -11 | 6, CL_de 0.35 | 0.2, Cm_alpha -1.3 | 0.6, Cm_q -28 | 12, Cm_de "
    "-2.1 | 0.8"
)
# The true values times 1.1, and a fifth of the true values: the priors that the printed sigmas of
# Cm_q show.
_PAPERS = (
    "CL_alpha 3.2142 | 0.5844, CL_q -16.17 | 2.94, CL_de 0.4785 | 0.087, Cm_alpha -1.826 | 0.332, "
    "Cm_q -38.225 | 6.95, Cm_de -2.8358 | 0.5156"
)
_MODE = (
    "CL_eta1 0.035 | 0.015, CL_etadot1 0.07 | 0.05, Cm_eta1 -0.026 | 0.012, Cm_etadot1 -0.12 | "
    "0.08, Ceta1_alpha -0.012 | 0.006, "
    "Ceta1_q -0.07 | 0.04, Ceta1_eta1 0 | 0.0003, Ceta1_etadot1 -0.0006 | 0.0004, Ceta1_de -0.01 | "
    "0.004"
)
_MODAL_REST = f"{_REST}, eta1 0 | 0.02, etadot1 0 | 0.2"
_FAR = "beta 800 lb/ft2 | 300 lb/ft2"

STARTS = {
    "ballistic": {
        "estimate": f"beta 550 lb/ft2 | 110 lb/ft2, {_FALL}",
        **dict.fromkeys(
            (
                "paper-two-terms",
                "paper-three-terms",
                "paper-true-fall",
                "paper-start-rk4",
                "paper-start-cured",
            ),
            _FAR,
        ),
    },
    "ballistic-process-noise": {
        "estimate": f"beta 550 lb/ft2 | 110 lb/ft2, {_FALL}",
        **dict.fromkeys(("paper-two-terms", "paper-three-terms", "paper-true-fall"), _FAR),
    },
    "flexibility-sweep": {
        "estimate": f"{_HANDBOOK}, {_REST}",
        "first-mode": f"{_MODE}, eta1 0 | 0.02, etadot1 0 | 0.2",
    },
    "rigid": {"estimate": f"{_HANDBOOK}, {_REST}"},
    "rigid-euler": {"estimate": f"{_PAPERS}, {_REST}"},
    "rigid-process-noise-a": {"estimate": f"{_HANDBOOK}, {_REST}", "paper-filter": _PAPERS},
    "rigid-process-noise-b": {"estimate": f"{_HANDBOOK}, {_REST}", "paper-filter": _PAPERS},
    **{
        key: {"estimate": f"{_HANDBOOK}, {_REST}"}
        for key in ("flexible-ac1-equivalent", "flexible-ac2-equivalent")
    },
    **{
        key: {"estimate": f"{_HANDBOOK}, {_MODE}, {_MODAL_REST}"}
        for key in ("flexible-ac1-first-mode", "flexible-ac2-first-mode")
    },
}


def printed() -> dict[str, Decimal]:
    """Every printed value and standard deviation, by ``table.column.name.value`` or ``.std``."""
    return dict(_printed())


def _printed() -> Iterator[tuple[str, Decimal]]:
    for table, text in TABLES.items():
        heading, *rows = (line.split() for line in text.strip().splitlines())
        for name, *cells in rows:
            for at, column in enumerate(heading[1:]):
                for kind, cell in zip(("value", "std"), cells[2 * at : 2 * at + 2], strict=True):
                    yield f"{table}.{column}.{name}.{kind}", Decimal(cell)


def true_values(vehicle: str) -> dict[str, tuple[Decimal, str]]:
    """The printed true values of a vehicle as number and unit, by name."""
    entries = (entry.split(" ", 2) for entry in TRUE[vehicle].split(", "))
    return {name: (Decimal(number), " ".join(unit)) for name, number, *unit in entries}


def declared(scenario: str) -> dict[str, tuple[Decimal, str]]:
    """Every start and standard deviation of a scenario as number and unit, by
    ``estimate.name.value`` or ``METHOD.name.std``.
    """
    out = {}
    for place, text in STARTS[scenario].items():
        for entry in text.split(", "):
            name, rest = entry.split(" ", 1)
            for kind, quantity in zip(("value", "std"), rest.split(" | "), strict=True):
                number, _, unit = quantity.partition(" ")
                out[f"{place}.{name}.{kind}"] = (Decimal(number), unit)
    return out
