"""The declaration of the page (pydantic): pairs of a printed number and a number of a study, and
the reasons of their differences.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from decimal import Decimal
from importlib.resources import files
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from scenarios.files.declarations import checked
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from sim.errors import DeclarationError

PAPERS = ("simulated_flight_data", "short_period_dynamics")
Text = Annotated[str, Field(min_length=1)]
_DIGITS = r"[-+]?\d*\.?\d+(?:e[-+]?\d+)?"
_PRINTED = re.compile(rf"({_DIGITS})(?: (\+-|var|to) ({_DIGITS}))?")


class _Strict(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT


class Values(_Strict):
    """Printed numbers of one table or column, one row each.

    ``study``: ``SCENARIO`` or ``SCENARIO/METHOD``. ``published``: ``TABLE.COLUMN`` of the paper's
    file of published numbers, of which ``names`` is the part that is shown; ``printed``: numbers
    that this file does not hold, see ``printed_of``. ``path``: where the study has ``{name}``.
    ``reference``: what both are also held against. ``turned``: whether the signs of
    ``Paper.turned`` apply. ``unit``: of the page, ours are converted; ``own_unit``: of ours where
    the study tells none. ``zero``: quantities that are zero in print and in ours, one row together.
    ``note``: what holds for all rows. ``why``: of rows beyond two sigmas, and of all that are not
    compared in sigmas; ``within``: of the others; ``found``: in place of both where ours is within
    two sigmas of the reference; ``reasons``: of one row.
    """

    label: Text
    study: Text
    published: str = ""
    names: list[str] = []
    printed: dict[str, str] = {}
    path: str = "{name}"
    reference: Literal["", "true", "condensed", "loop_equivalent"] = ""
    unit: str = ""
    own_unit: str = ""
    zero: list[str] = []
    note: str = ""
    turned: bool = True
    compare: Literal["sigmas", "ratio", "difference", "none"] = "sigmas"
    within: Text = "within two sigmas"
    found: str = ""
    why: str = ""
    reasons: dict[str, Text] = {}


class Matrix(_Strict):
    """A printed correlation matrix, its upper triangle row by row without the diagonal, beside a
    study's.
    """

    label: Text
    study: Text
    names: list[str]
    upper: list[Text]
    why: Text


class Statement(_Strict):
    """A figure, a conclusion or a reading of the print.

    ``figure``: its counterpart, ``SCENARIO/FILE``. ``numbers``: by the names that ``ours`` uses in
    braces, each ``STUDY: PATH``. ``holds``: conditions on them, ``"lag < 0.1"`` or ``"|lag| >
    other"``, without which ``agrees`` would no longer follow.
    """

    place: Text
    says: Text
    ours: Text
    agrees: Literal["yes", "partly", "no", "open", "no number"]
    why: Text
    figure: str = ""
    numbers: dict[str, Text] = {}
    holds: list[Text] = []


class Part(_Strict):
    """A table of the paper, its figures, or its conclusions. ``true``: printed true values;
    ``misprints``: those that are not flown, and why. ``together``: the rows of all ``values`` in
    one table, for those with the same columns."""

    heading: Text
    about: str = ""
    units: str = ""
    true: dict[str, Text] = {}
    misprints: dict[str, Text] = {}
    together: bool = False
    values: list[Values] = []
    matrices: list[Matrix] = []
    statements: list[Statement] = []


class Remark(_Strict):
    """A comparison of one study, ``SCENARIO`` or ``SCENARIO/METHOD``, with the paper in words."""

    study: Text
    text: Text


class Paper(_Strict):
    """One paper. ``turned``: quantities whose sign is ours turned; ``published`` names its file of
    published numbers; ``remarks`` stand at the end.
    """

    schema_: Literal["flightid/reproduction/1"] = Field(alias="schema")
    title: Text
    source: Text
    about: Text
    published: Text
    turned: list[str] = []
    parts: list[Part]
    remarks: list[Remark] = []


@dataclass(frozen=True)
class Printed:
    """A number as a paper prints it: its digits, its standard deviation if there is one, and the
    end of a range if it is one.
    """

    value: Decimal
    std: float | None = None
    upper: Decimal | None = None
    std_text: str = ""

    def text(self) -> str:
        """``"0.6756 +- 0.01976"``, ``"0.140 to 0.146"``."""
        return f"{digits(self.value)}{f' to {digits(self.upper)}' if self.upper is not None else ''}{f' +- {self.std_text}' if self.std_text else ''}"  # noqa: E501


def digits(value: Decimal) -> str:
    """The digits as printed, small and large numbers with a power of ten, ``-2.49e-5``."""
    if not value:
        return "0"
    return (
        f"{value:f}"
        if -5 < value.adjusted() < 7
        else f"{value.normalize():e}".replace("e-0", "e-").replace("e+0", "e")
    )


def printed_of(text: str, where: str) -> Printed:
    """A printed number from ``"4.26"``, ``"1.2 +- 0.3"``, ``"1.2 var 0.09"`` or ``"0.140 to
    0.146"``. Raises DeclarationError for another form.
    """
    found = _PRINTED.fullmatch(text)
    if found is None:
        raise DeclarationError(
            f"{text!r} is no printed number",
            where=where,
            remedy="write 1.2, 1.2 +- 0.3, 1.2 var 0.09 or 1.2 to 1.3",
        )
    value, kind, second = Decimal(found[1]), found[2], found[3]
    if kind == "to":
        return Printed(value, upper=Decimal(second))
    if kind == "var":
        return _with_variance(value, Decimal(second))
    return Printed(value, float(second), std_text=second) if kind else Printed(value)


def _with_variance(value: Decimal, variance: Decimal) -> Printed:
    std = float(variance) ** 0.5
    return Printed(value, std, std_text=f"{std:.2g}".replace("e-0", "e-"))


def published_of(paper: Paper, column: str) -> dict[str, Printed]:
    """A column, ``TABLE.COLUMN``, of the paper's published numbers with the signs that the paper
    prints. Raises DeclarationError.
    """
    content = (
        files("scenarios.studies")
        .joinpath("published", f"{paper.published}.toml")
        .read_text(encoding="utf-8")
    )
    table, _, name = column.partition(".")
    cells = tomllib.loads(content, parse_float=Decimal).get(table, {}).get(name)
    if not isinstance(cells, dict):
        raise DeclarationError(
            f"there is no column {column!r}",
            where=f"published {paper.published}",
            remedy="name TABLE.COLUMN of that file",
        )
    out = {}
    for quantity, cell in cells.items():
        if not isinstance(cell, dict) or "value" not in cell:
            continue
        value = -cell["value"] if quantity in paper.turned else cell["value"]
        if "variance" in cell:
            out[quantity] = _with_variance(value, cell["variance"])
        else:
            std = cell.get("std")
            out[quantity] = (
                Printed(value) if std is None else Printed(value, float(std), std_text=digits(std))
            )
    return out


def printed_values(paper: Paper, group: Values) -> dict[str, Printed]:
    """The printed numbers of a group by quantity, in the order in which they are shown. Raises
    DeclarationError.
    """
    where = f"{paper.published}, {group.label}"
    known = published_of(paper, group.published) if group.published else {}
    missing = [name for name in group.names if name not in known]
    if missing:
        raise DeclarationError(
            f"no {', '.join(missing)} is published in {group.published or 'any column'}",
            where=where,
            remedy="see its file",
        )
    out = {name: known[name] for name in group.names or known} | {
        name: printed_of(text, where) for name, text in group.printed.items()
    }
    unknown = [name for name in group.reasons if name not in out]
    if unknown or not out:
        raise DeclarationError(
            f"no row {', '.join(unknown)}",
            where=where,
            remedy="give reasons for rows of the group, and rows",
        )
    return out


def paper_of(name: str) -> Paper:
    """One of ``PAPERS`` from its file beside this one. Raises DeclarationError: one line on the
    first fault.
    """
    file = f"{name}.toml"
    return checked(
        Paper,
        tomllib.loads(files("exam.reproduction").joinpath(file).read_text(encoding="utf-8")),
        file,
    )
