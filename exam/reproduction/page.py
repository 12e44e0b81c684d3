"""The page as Markdown: paper by paper, table by table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from textwrap import fill

from exam.reproduction.declaration import Matrix, Paper, Part, Values
from exam.reproduction.lookups import Numbers
from exam.reproduction.rows import CLOSE, Row, Told, cells_of, rows_of, told
from sim.errors import DeclarationError

HEAD = """# The two papers, number by number

Every table, figure and conclusion of the two papers that this project began with: what they print, what our studies find, how far apart the
two are, and why. `python -m exam papers-page` runs the studies and writes this page; the reasons stand in
`exam/reproduction` ([how to add a row](../exam/reproduction/README.md)).

**Δ** is ours minus the printed value in sigmas: over the root of the sum of both variances, or over the one standard deviation that
is known where the other prints none; in per cent where there is none at all. `x 1.9`: ours is 1.9 times the printed number, where both are
settings or variances. `+-` is one standard deviation. **Error** is the distance of the printed value and of ours from the reference (the
value in the column before "printed"), each in its own sigmas. A study is `SCENARIO` or `SCENARIO/METHOD`: run it with
`flightid run SCENARIO --out study`, or see all of them with `flightid list`.
"""  # noqa: E501
WIDTH = 150  # width of a line of prose in the file
_REFERENCES = {"true": "", "condensed": "condensed", "loop_equivalent": "loop's own"}
_ERROR = "error (printed; ours)"


class Tally:
    """Counts of rows while the page is written."""

    def __init__(self) -> None:
        self.rows: Counter[str] = Counter()
        self.statements: Counter[str] = Counter()

    def add(self, group: Values, rows: Sequence[Row]) -> None:
        """Count the rows of a group; a row for several quantities counts as several."""
        self.rows["all"] += len(rows) + max(len(group.zero) - 1, 0)
        self.rows.update(
            "close" if abs(row.sigmas) <= CLOSE else "far" for row in rows if row.sigmas is not None
        )

    def line(self) -> str:
        """Return a line on the contents of the paper on the page."""
        rows, agreed = self.rows, self.statements
        told = ", ".join(
            f"{count} {word}" for word, count in sorted(agreed.items(), key=lambda each: -each[1])
        )
        others = rows["all"] - rows["close"] - rows["far"]
        return (
            f"{rows['all']} rows of numbers: {rows['close']} within two sigmas, {rows['far']} "
            f"beyond, {others} not compared in sigmas. "
            f"{sum(agreed.values())} figures, conclusions and readings; ours agrees: {told}."
        )


def page_of(papers: Iterable[Paper], numbers: Numbers) -> str:
    """Return the whole page. Raises DeclarationError as ``rows_of``, ``told`` and ``cells_of``."""
    return HEAD + "".join(_paper(paper, numbers) for paper in papers)


def _paper(paper: Paper, numbers: Numbers) -> str:
    tally = Tally()
    parts = "".join(_part(paper, part, numbers, tally) for part in paper.parts)
    return (
        "\n## "
        f"{paper.title}\n\n{_wrapped(paper.source)}\n\n{_wrapped(paper.about)}\n\n{_wrapped(tally.line())}\n{parts}{_remarks(paper)}"
    )


def _remarks(paper: Paper) -> str:
    """Return the remarks of each study as a paragraph; empty without any."""
    told = [_wrapped(f"**`{remark.study}`**: {remark.text}") for remark in paper.remarks]
    return "\n\n".join(["\n### Remarks on single studies", *told]) + "\n" if told else ""


def _part(paper: Paper, part: Part, numbers: Numbers, tally: Tally) -> str:
    out = [f"\n### {part.heading}\n"]
    if part.about:
        out.append(f"\n{_wrapped(part.about)}\n")
    if part.units:
        out.append(f"\n{_wrapped(f'Units: {part.units}.')}\n")
    for matrix in part.matrices:
        out.append(_matrix(paper, matrix, numbers))
        tally.rows["all"] += len(matrix.names) * (len(matrix.names) - 1) // 2
    groups = [(group, rows_of(paper, part, group, numbers)) for group in part.values]
    for group, rows in groups:
        tally.add(group, rows)
    if part.together:
        out.append("\n" + _rows_table(part, groups))
    else:
        out += [
            f"\n{_heading(group)}\n\n{_rows_table(part, [(group, rows)])}" for group, rows in groups
        ]
    if part.statements:
        tally.statements.update(statement.agrees for statement in part.statements)
        out.append(_statements([told(statement, numbers) for statement in part.statements]))
    if part.misprints:
        out.append(
            "\n"
            + "\n".join(_wrapped(f"True `{name}`: {why}") for name, why in part.misprints.items())
            + "\n"
        )
    return "".join(out)


def _heading(group: Values) -> str:
    return _wrapped(
        f"**{group.label[0].upper()}{group.label[1:]}**: ours is `{group.study}`. {group.note}"
    )


def _rows_table(part: Part, groups: Sequence[tuple[Values, Sequence[Row]]]) -> str:
    """Return one table of the rows of one group, or of several groups with the same columns, which
    are then named.
    """
    kinds = {group.reference for group, _ in groups}
    if len(kinds) > 1:
        raise DeclarationError(
            "groups with several references",
            where=part.heading,
            remedy="give each the same, or strike together",
        )
    (kind,) = kinds
    reference = _REFERENCES.get(kind, "")
    heads = [
        "quantity",
        *(["ours is"] if part.together else []),
        *(["true"] if part.true else []),
        *([reference] if reference else []),
    ]
    heads += ["printed", "ours", "Δ", *([_ERROR] if kind else []), "why"]
    lines = []
    for group, rows in groups:
        whose = [f"{group.label}: `{group.study}`"] if part.together else []
        for row in rows:
            cells = [
                f"`{row.name}`",
                *whose,
                *([row.true] if part.true else []),
                *([row.reference] if reference else []),
                row.printed,
                row.ours,
            ]
            lines.append([*cells, row.difference, *([row.off] if kind else []), row.why])
    return table(heads, lines)


def _statements(rows: Sequence[Told]) -> str:
    figures = any(row.figure for row in rows)
    heads = ["where", "the paper", *(["our figure"] if figures else []), "ours", "agrees", "why"]
    lines = [
        [
            r.place,
            r.says,
            *([f"`{r.figure}`" if r.figure else "none"] if figures else []),
            r.ours,
            r.agrees,
            r.why,
        ]
        for r in rows
    ]
    return "\n" + table(heads, lines)


def _matrix(paper: Paper, matrix: Matrix, numbers: Numbers) -> str:
    """Return the printed triangle above the diagonal and ours below it, and the largest
    difference.
    """
    cells = cells_of(matrix, paper.turned, numbers)
    lines = []
    for i, a in enumerate(cells.names):
        line = [f"{i + 1} `{a}`"]
        for j, b in enumerate(cells.names):
            line.append(
                "1" if i == j else _short(cells.printed[a, b] if i < j else cells.ours[b, a])
            )
        lines.append(line)
    a, b = cells.worst
    told = (
        f"Root mean square of the {len(cells.printed)} differences {cells.rms:.2f}; `{a}` with "
        f"`{b}` differs most, "
    )
    told += f"printed {cells.printed[a, b]:.2f}, ours {cells.ours[a, b]:.2f}. Why: {matrix.why}"
    heads = ["", *(str(i) for i in range(1, len(cells.names) + 1))]
    return (
        f"\n**{matrix.label}**: printed above the diagonal, ours (`{matrix.study}`) "
        f"below.\n\n{table(heads, lines)}\n{_wrapped(told)}\n"
    )


def _short(correlation: float) -> str:
    """Return a number as ``"-.33"``, so that thirteen columns fit a page."""
    text = f"{correlation:.2f}"
    return "0" if not float(text) else text.replace("0.", ".")


def table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table. Raises DeclarationError for an empty cell; only the first head may
    be empty.
    """
    out = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for line in lines:
        cells = [_prose(cell).replace("|", "\\|") for cell in line]
        if not all(cells) or len(cells) != len(heads):
            raise DeclarationError(
                f"an empty cell beside {cells[0]}", where="reproduction", remedy="fill it"
            )
        out.append("| " + " | ".join(cells) + " |")
    return "\n".join(out) + "\n"


def _prose(text: str) -> str:
    return " ".join(text.split())


def _wrapped(text: str) -> str:
    return fill(_prose(text), WIDTH, break_long_words=False, break_on_hyphens=False)
