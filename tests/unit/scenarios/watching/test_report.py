"""What the page of a watch says of the reference: nothing agrees that was not compared."""

from __future__ import annotations

import pytest

from scenarios.report.document import Table
from scenarios.watching.show import spectral_page
from scenarios.watching.study import against


@pytest.mark.parametrize(
    ("outside", "hanging", "compared", "said"),
    [
        (["M_q"], ["delay"], 7, "outside the reference, 1 of 7 quantities: M_q"),
        ([], [], 10, "every quantity that was compared agrees with its reference, 10 of them"),
        (
            [],
            ["M_q", "delay"],
            8,
            "every quantity that was compared agrees with its reference, 8 of them; M_q, delay not "
            "compared, for the start decides",
        ),
        ([], ["M_q"], 0, "nothing was compared; M_q not compared, for the start decides"),
        ([], [], 0, "nothing was compared"),
    ],
)
def test_agreement_is_told_of_what_was_compared_alone(
    outside: list[str], hanging: list[str], compared: int, said: str
) -> None:
    assert against(outside, hanging, compared) == said


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
    assert alone.sentence == "90 rows of flight.csv, 1 left out, 0 mended." and not alone.summary
    page = spectral_page({**content, "reference": reference}, "flight.csv", "0" * 64)
    assert (page.verdict, page.sentence) == (
        "outside the reference",
        "1 of 2 quantities are more than two sigmas off before: damping ratio.",
    )
    (beside,) = [each for each in page.sections if each.title == "Against the reference"]
    (table,) = beside.blocks
    assert isinstance(table, Table)
    assert [(row[0], row[-1]) for row in table.rows] == [
        ("damping ratio", "outside"),
        ("Cm_q", ""),
    ]
