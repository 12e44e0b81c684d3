"""The page of a watch that has ended: the last estimate, what the bank of delays says, the reference beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.pages.model import BY_ROW, PURE, Block, Cell, Column, Number, Page, Table, as_sentence, capital, estimate, now, reproduction, section
from scenarios.pages.tables import derived_table, estimates_table, fixed_table
from scenarios.studies.rows import Row


def watch_page(content: Mapping[str, Any], name: str, digest: str) -> Page:
    """The page of ``content``, what stands in ``comparison.json``; ``digest`` is that of the rows that were taken."""
    stream, reference, methods = content["stream"], content.get("reference"), content.get("methods", {})
    outside = list(reference["outside"]) if reference else []
    told = f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['mended']} mended, {stream['spikes']} spikes"
    words = against(outside, content.get("start_dependent", ()), len(reference["differences"])) if reference else ""
    refined = {"online": "as the stream left it", "online-refined": "refined on line"}.get(content["method"], "refined over all rows")
    return Page(
        title=f"{capital(content['vehicle'])}: a stream identified while it arrived",
        kind=f"Watch of {name}, low-order equivalent system, {refined}",
        verdict="outside the reference" if outside else content["outcome_sentence"].partition(":")[0].partition(",")[0],
        tone="fair" if outside else "good" if content["outcome"] == "converged" else "open",
        sentence=as_sentence(words) if reference else as_sentence(told),
        summary=(as_sentence(told),) if reference else (),
        warnings=tuple(content.get("warnings", ())),
        sections=(
            *section("What was found", *_found(content)),
            *section("As the stream left it", *(_found(methods["online"]) if "online" in methods else ())),
            *section("In the frequency domain", *(_found(methods["frequency-domain"]) if "frequency-domain" in methods else ())),
            *section("Against the reference", _differences(reference) if reference else None),
            *section("The bank of delays", _bank(content["bank"])),
            *section("How it was made", fixed_table("What was held", {key: (each["value"], each["unit"]) for key, each in content["fixed"].items()})),
        ),
        reproduction=reproduction(
            ["flightid", "watch", name, "--model", "loes"], as_sentence(f"the stream ended: {stream['ended']}"), [("rows", name, digest)]
        ),
        created=now(),
    )


def against(outside: Sequence[str], hanging: Sequence[str], compared: int) -> str:
    """How a stream stands against its reference: quantities ``outside`` it, how many were ``compared``, and which hang on the start instead."""
    if outside:
        return f"outside the reference, {len(outside)} of {compared} quantities: {', '.join(outside)}"
    left = f"; {', '.join(hanging)} not compared, for the start decides" if hanging else ""
    return (f"every quantity that was compared agrees with its reference, {compared} of them" if compared else "nothing was compared") + left


def _found(content: Mapping[str, Any]) -> list[Block]:
    rows = [Row(name, each["unit"], each["estimate"], each["std"]) for name, each in content["parameters"].items()]
    derived = {name: (each["estimate"], each["std"]) for name, each in content["derived"].items()}
    return [estimates_table("Parameters", rows), *([derived_table("What follows from them", derived)] if derived else [])]


def _differences(reference: Mapping[str, Any]) -> Table:
    columns = Column("quantity"), Column("reference ± σ", BY_ROW), Column("apart", "σ"), Column("remark")
    rows: list[tuple[Cell, ...]] = []
    for each in reference["differences"]:
        known = estimate(each["reference"], each["reference_std"])
        rows.append((each["name"], known, Number(each["sigmas"], digits=1, signed=True), "outside" if each["outside"] else ""))
    caption = f"The last estimate against {reference['study']}"
    return Table(caption, columns, tuple(rows), tuple(each["unit"] or PURE for each in reference["differences"]))


def _bank(bank: Mapping[str, Any]) -> Table:
    rows = tuple(
        (Number(float(delay)), Number(float(weight), shown=f"{weight:.3g}")) for delay, weight in zip(bank["delays"], bank["weights"], strict=True)
    )
    return Table("Likelihood of each delay by the plain filters", (Column("delay", "s"), Column("likelihood", PURE)), rows)
