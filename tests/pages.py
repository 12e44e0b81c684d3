"""A page with everything that a page can hold, and texts in it that try to be markup."""

from __future__ import annotations

from scenarios.report.document import (
    BY_ROW,
    Bullets,
    Column,
    Figure,
    Fold,
    Number,
    Page,
    Prose,
    Reproduction,
    Section,
    Table,
    section,
)

HOSTILE = '<script>alert("x")</script> & <b>'
ESTIMATES = Table(
    "Estimates",
    (
        Column("parameter"),
        Column("true", BY_ROW),
        Column("estimate ± σ", BY_ROW),
        Column("error", "%"),
    ),
    (
        ("Cm_alpha", Number(-1.66), Number(-1.657, 0.0018), Number(0.18)),
        ("CL_q", Number(-14.7), Number(-15.44, 0.77), Number(-5.04)),
        ("CL_alpha", Number(2.922), Number(2.92, 0.014), "–"),
        ("delay", "–", "not determined", "–"),
    ),
    ("1/rad", "1/rad", "1/rad", "s"),
)
CANDIDATES = Table(
    "Candidates",
    (Column("candidate"), Column("gain", "1")),
    tuple((f"candidate-{i}", Number(100.0 - i)) for i in range(60)),
    printed=10,
)
INPUTS = (("fitted", "a -1.csv", "ab" * 32),)
DRAWING = (
    '<svg viewBox="0 0 504 100" width="882" height="175" class="full" role="img" aria-label="A '
    'line."><path d="m0 0l504 100" stroke="#000000"/></svg>'
)
PAGE = Page(
    title=f"rigid {HOSTILE}",
    kind=f"Study of {HOSTILE}",
    verdict="converged",
    tone="good",
    sentence="All is well.",
    summary=("frequency 1.97 +- 0.01 rad/s.", HOSTILE),
    warnings=(HOSTILE,),
    sections=(
        *section("Parameters", Prose("told", term="Name:"), ESTIMATES, CANDIDATES),
        *section(
            "Parameters",
            Fold("More", ("folded words",)),
            Bullets(("one", HOSTILE), numbered=True),
            Bullets(("plain",)),
        ),
        *section("Figures", Figure("figure-fit", DRAWING, "The fit")),
        Section(
            "Parts",
            parts=(
                Section(
                    "An effect", (Prose("a note", "note"), Prose("x = 1", "code")), card="hint"
                ),
            ),
        ),
    ),
    reproduction=Reproduction(
        (f"flightid run '{HOSTILE}' --seed 1",),
        {"flightid": "0.1.0", "numpy": "2"},
        "Seed 1.",
        (("fitted", "a -1.csv", "ab" * 32),),
    ),
    created="2026-11-23T08:10:00Z",
)
