"""What the page of a watch says of the reference: nothing agrees that was not compared."""

from __future__ import annotations

import pytest

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
