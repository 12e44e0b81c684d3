"""The two papers' tables, written a second time from their text: quantity, true value where there
is one, value, and sigma or variance.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal

# Heading of the page and the printed column, then the lines of the table. "v" before a number: a
# variance.
SIMULATED_FLIGHT_DATA = """
Table 1: two terms
beta 497.8827 0.290904
Table 1: three terms
beta 499.8196 0.290046
Table 2: two terms
beta 488.9278 11.07214
Table 2: three terms
beta 488.7636 11.23639
Table 3: No process noise
CL_alpha 2.9096 0.00764
CL_q -22.7217 0.75708
CL_de 0.6756 0.01976
Cm_alpha -1.6078 0.00166
Cm_q -38.3583 6.68809
Cm_de -2.25619 0.00289
Table 3: Process noise, case A
CL_alpha 2.8772 0.06228
CL_q -16.6971 1.78776
CL_de -0.3212 0.13688
Cm_alpha -1.8501 0.03303
Cm_q -39.0636 6.9463
Cm_de -2.7122 0.10493
Table 3: Process noise, case B
CL_alpha 2.8887 0.08767
CL_q -16.8602 1.89439
CL_de -0.2328 0.14417
Cm_alpha -1.6099 0.0784
Cm_q -41.527 6.94662
Cm_de -2.8064 0.0588
Table 4: AC1
CL_alpha 2.4927 0.006445
CL_q -1.5588 0.6973
CL_de 0.9644 0.0179
Cm_alpha -1.3141 0.0012
Cm_q -20.6907 6.6134
Cm_de -2.2514 0.00271
Table 4: AC2
CL_alpha 1.7955 0.017004
CL_q -7.7374 2.56618
CL_de -0.2195 0.06234
Cm_alpha -0.4582 0.001378
Cm_q -15.2807 6.932
Cm_de -1.5197 0.00752
Table 5: AC1
CL_alpha 3.2861 0.0445
CL_q -13.2036 1.02
CL_de 0.8184 0.0312
Cm_alpha -1.6082 0.0084
Cm_q -32.4563 0.2808
Cm_de -2.565 0.0145
CL_eta1 0.0556 0.0024
CL_etadot1 0.0905 0.0163
Cm_eta1 -0.0411 0.0025
Cm_etadot1 -0.0799 0.022
Ceta1_alpha -0.017 0.0018
Ceta1_q -0.1 0.0186
Ceta1_eta1 0.00062 0.0001
Ceta1_etadot1 -0.000587 0.00007
Ceta1_de -0.0127 0.0012
Table 5: AC2
CL_alpha 3.0798 0.03598
CL_q -24.6586 1.7327
CL_de 0.2619 0.03821
Cm_alpha -1.8725 0.01857
Cm_q -41.1266 0.49461
Cm_de -2.1175 0.01376
CL_eta1 0.012 0.000479
CL_etadot1 0.1792 0.01244
Cm_eta1 -0.0201 0.000129
Cm_etadot1 -0.1873 0.00451
Ceta1_alpha -0.0244 0.000281
Ceta1_q -0.0672 0.009936
Ceta1_eta1 0.000126 0.000002
Ceta1_etadot1 -0.000842 0.000027
Ceta1_de -0.009864 0.000217
"""

TRUE = """
beta 500
CL_alpha 2.922
CL_q -14.7
CL_de 0.435
Cm_alpha -1.66
Cm_q -34.75
Cm_de -2.578
CL_eta1 0.0288
CL_etadot1 0.0848
Cm_eta1 0.0025
Cm_etadot1 -0.159
Ceta1_alpha -0.014898
Ceta1_q -0.0949
Ceta1_eta1 0.0000585
Ceta1_etadot1 -0.00042
Ceta1_de -0.012835
"""

_STATES = [
    "alpha",
    "q",
    "delta",
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "L_0",
    "M_0",
    "delta_0",
]
# Tables 1 and 2 line by line, and Table 3, each number in the order of its table; "?" where the
# reading has no number.
SHORT_PERIOD_DYNAMICS = {
    "Table 1: initial estimate": (
        "0 0 0 -0.191e1 -0.140e2 0.130e-3 -0.377 0.101e1 -0.368e1 0.792e1 0 0 0"
    ),
    "Table 1: final estimate": (
        "0.505e-2 -0.171e-1 0.706e-1 -0.191e1 -0.124e2 -0.249e-4 -0.317 0.101e1 -0.299e1 0.106e2 "
        "-0.486e-3 0.187e-1 0.783"
    ),
    "Table 1: initial variance": (
        "0.116e-3 0.119e-3 0.100e-3 0.112 0.536e1 0.625e-3 0.596e-2 0.100e-1 0.266e1 0.156e1 "
        "0.100e-3 0.100e-1 0.225e1"
    ),
    "Table 1: final variance": (
        "0.404e-9 0.420e-7 0.212e-4 0.385e-5 0.113e-1 0.679e-9 0.120e-4 0.280e-6 0.244e-2 0.209e-1 "
        "0.822e-9 0.303e-5 0.232e-2"
    ),
    "Table 1: process noise": "0 0.500e-4 0 0 0 0 0 0 0 0 0 0 0",
    "Table 2: initial estimate": (
        "0 0 0 -0.191e1 -0.124e2 -0.249e-4 -0.317 0.101e1 -0.299e1 0.106e2 0 0 0"
    ),
    "Table 2: final estimate": (
        "0.553e-2 -0.611e-2 0.261e-1 -0.210e1 -0.895e1 -0.342e-4 -0.367 0.101e1 -0.619e1 0.146e2 "
        "-0.690e-4 0.944e-2 0.402"
    ),
    "Table 2: initial variance": (
        "0.116e-5 0.119e-5 0.100e-3 0.112 0.536e1 0.625e-3 0.596e-2 0.100e-1 0.266e1 0.156e1 "
        "0.100e-3 0.100e-1 0.225e1"
    ),
    "Table 2: final variance": (
        "0.297e-8 0.874e-7 0.122e-4 0.725e-4 0.247e-1 0.746e-8 0.492e-4 0.595e-5 0.189e-1 0.891e-1 "
        "0.750e-8 0.245e-5 0.263e-2"
    ),
    "Table 2: process noise": "0 0.500e-4 0 0 0 0 0 0 0 0 0 0 0",
    "Table 3: Time shift": "? ? ? -2.10 -8.42 -6.31e-4 -0.346 1.02 -5.76 16.8 2.34e-5 9.20e-3 4.62",
    "Table 3: Convergence": (
        "? ? ? -2.09 -8.31 -2.66e-5 -0.370 1.01 -5.36 19.1 -4.75e-5 -2.22e-3 -8.73e-2"
    ),
    "Table 3: Flight": "? ? ? ? ? -3.24e-5 ? ? ? ? ? ? ?",
}
# Measurement noise of alpha, q and nz; undamped natural frequency and damping ratio of both
# headings.
NOISE = {"Table 1": "0.382e-3 0.391e-3 0.138e-5", "Table 2": "0.382e-2 0.391e-2 0.138e-4"}
HEADINGS = {"simulation": ("4.2596", "0.5753"), "flight": ("4.6965", "0.8823")}

# Correlation matrices: rows as the text has them, lower triangles, which were read apart from the
# upper ones.
LOWER = {
    "Table 1": """
q 0.15506
delta -0.24955 0.05098
L_alpha 0.41331 -0.06954 -0.02653
M_alpha 0.06827 0.04102 -0.00236 0.01610
L_delta -0.32304 0.03762 0.11107 -0.48989 -0.12624
M_delta 0.08508 -0.07725 0.14909 0.08355 0.54708 -0.22689
L_q -0.39590 0.03875 0.06080 -0.59820 -0.09847 0.77509 -0.17641
M_q 0.10736 -0.10829 -0.12547 0.19205 0.34516 -0.21938 0.92781 -0.20940
inv_tau 0.07459 -0.03979 -0.15092 0.06850 0.73953 -0.16148 0.84812 -0.04785 0.73248
L_0 0.74554 -0.01686 -0.34409 0.00178 0.01722 -0.07766 0.07540 -0.05120 0.06831 0.07437
M_0 -0.17110 0.06768 0.96273 -0.04350 -0.12007 0.14283 -0.31789 0.08488 -0.28246 -0.30871 -0.23452
delta_0 -0.24041 0.04516 0.98721 -0.01579 0.11690 0.08631 -0.01402 0.05378 -0.00877 0.00863 -0.33607 0.92405
""",  # noqa: E501
    "Table 2": """
q 0.15520
delta 0.30339 0.01213
L_alpha 0.45422 -0.19339 0.01650
M_alpha 0.00249 0.17469 0.03627 -0.15129
L_delta -0.32055 0.09181 -0.02646 -0.52764 -0.02030
M_delta 0.02536 -0.08694 -0.00437 0.08438 0.46982 -0.30411
L_q -0.37004 0.11508 -0.02290 -0.62633 0.06861 0.86501 -0.22896
M_q 0.08520 -0.14395 0.00088 0.23443 0.32570 -0.34107 0.96893 -0.31818
inv_tau 0.01546 -0.02172 0.02419 0.06157 0.67047 -0.13320 0.87585 0.01716 0.81066
L_0 0.75852 0.03066 0.38338 -0.01968 -0.03501 -0.02950 -0.04645 -0.01880 -0.04257 -0.04749
M_0 0.48553 0.03982 0.92657 0.00016 -0.05660 0.00150 -0.13821 0.00127 -0.12910 -0.10711 0.62764
delta_0 0.30227 0.00948 0.99320 0.02351 0.11401 -0.04172 0.09768 -0.02069 0.09529 0.14043 0.37416 0.90518
""",  # noqa: E501
}
# Read with one sign above the diagonal and another below it; M_q, which goes with M_delta, says
# which: -0.125 with delta.
SIGN_LOST = {("Table 1", "delta", "M_delta"): "-0.14909"}

Cell = tuple[Decimal, Decimal | None]


def first_paper() -> dict[str, dict[str, Cell]]:
    """Value and sigma by ``"Table 3: No process noise"`` and quantity."""
    out: dict[str, dict[str, Cell]] = {}
    for line in SIMULATED_FLIGHT_DATA.strip().splitlines():
        if line.startswith("Table"):
            column = out.setdefault(line, {})
        else:
            name, value, std = line.split()
            column[name] = (Decimal(value), Decimal(std))
    return out


def true_values() -> dict[str, Decimal]:
    """The first paper's true values."""
    return {
        name: Decimal(value) for name, value in (line.split() for line in TRUE.strip().splitlines())
    }


def second_paper() -> dict[str, dict[str, Decimal]]:
    """Numbers by ``"Table 1: final variance"`` and state."""
    return {
        title: {
            name: Decimal(word)
            for name, word in zip(_STATES, line.split(), strict=True)
            if word != "?"
        }
        for title, line in SHORT_PERIOD_DYNAMICS.items()
    }


def correlations(table: str) -> Iterator[tuple[str, str, Decimal]]:
    """Each pair of a matrix once, the earlier name first."""
    for line in LOWER[table].strip().splitlines():
        later, *entries = line.split()
        for earlier, entry in zip(_STATES, entries, strict=False):
            yield earlier, later, Decimal(SIGN_LOST.get((table, earlier, later), entry))


def numbers_in(text: str) -> list[Decimal]:
    """Numbers of a cell of the page."""
    return [Decimal(found) for found in re.findall(r"-?\d*\.?\d+(?:e-?\d+)?", text)]
