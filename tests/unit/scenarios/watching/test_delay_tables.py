"""Tables of the delays on the page of a watch."""

from __future__ import annotations

import numpy as np

from scenarios.report.document import Table
from scenarios.report.terminal import cell_text
from scenarios.watching.reference import delay_tables


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
