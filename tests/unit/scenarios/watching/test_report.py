"""What the page of a watch says of the reference: nothing agrees that was not compared."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.report.document import Table
from scenarios.report.terminal import cell_text
from scenarios.watching.reference import against, delay_tables
from scenarios.watching.show import spectral_page


@pytest.mark.parametrize(
    ("outside", "hanging", "compared", "said"),
    [
        (["M_q"], [], 7, "1 of 7 quantities is more than two sigmas from x: M_q"),
        (["M_q", "L_q"], [], 7, "2 of 7 quantities are more than two sigmas from x: M_q, L_q"),
        ([], [], 10, "all 10 compared quantities agree with x within two sigmas"),
        (
            [],
            ["M_q", "delay"],
            8,
            "all 8 compared quantities agree with x within two sigmas; not compared, as they "
            "depend on the start: M_q, delay",
        ),
        (
            [],
            ["M_q"],
            0,
            "no quantity could be compared with x; not compared, as they depend on the start: M_q",
        ),
        ([], [], 0, "no quantity could be compared with x"),
    ],
)
def test_agreement_is_told_of_what_was_compared_alone(
    outside: list[str], hanging: list[str], compared: int, said: str
) -> None:
    assert against(outside, compared, "x", hanging) == said


def test_a_page_in_the_frequency_domain_shows_every_difference() -> None:
    stream = {"rows": 90, "left_out": 1, "mended": 0, "ended": "the file ended"}
    differences = [
        {
            "name": name,
            "unit": "1",
            "reference": 0.31,
            "reference_std": 0.0075,
            "sigmas": sigmas,
            "outside": abs(sigmas) > 2.0,
        }
        for name, sigmas in (("damping_ratio", -2.9), ("Cm_q", 0.4))
    ]
    reference = {"study": "before", "outside": ["damping_ratio"], "differences": differences}
    content = {
        "vehicle": "bomber",
        "model": "rigid",
        "stream": stream,
        "parameters": {"Cm_q": {"unit": "1/rad", "estimate": -22.0, "std": 2.0}},
    }
    alone = spectral_page(content, "flight.csv", "0" * 64)
    assert alone.sentence == "90 rows of flight.csv, 1 left out, 0 filled in." and not alone.summary
    page = spectral_page({**content, "reference": reference}, "flight.csv", "0" * 64)
    assert (page.verdict, page.sentence) == (
        "outside the reference",
        "1 of 2 quantities is more than two sigmas from before: damping ratio.",
    )
    (beside,) = [each for each in page.sections if each.title == "Against the reference"]
    (table,) = beside.blocks
    assert isinstance(table, Table)
    assert [(row[0], row[-1]) for row in table.rows] == [
        ("damping ratio", "outside"),
        ("Cm_q", ""),
    ]


def texts(table: Table) -> list[list[str]]:
    return [[cell_text(cell) for cell in row] for row in table.rows]


def test_the_page_shows_the_refined_delays_of_the_terminal_and_names_those_of_the_bank() -> None:
    """The page had the bank's likelihoods alone, beside other probabilities in the terminal."""
    bank = {
        "delays": np.array([0.125, 0.15]),
        "weights": np.array([1.0, 1.5e-24]),
        "refined": np.array([0.2606, 0.7394]),
    }
    refined, plain = delay_tables({"bank": bank})
    assert isinstance(refined, Table) and isinstance(plain, Table)
    assert texts(refined) == [["125", "0.26"], ["150", "0.74"]]
    assert "refined estimate, as the terminal prints it" in refined.caption
    assert texts(plain) == [["125", "1.00"], ["150", "0.00"]]
    assert plain.caption.startswith("Before the refinement")
    del bank["refined"]
    (alone,) = delay_tables({"bank": bank})
    assert isinstance(alone, Table) and "refine" not in alone.caption
