"""`flightid map`: what a recorder's file holds, and a draft of the channel map and of the vehicle file."""

from __future__ import annotations

from pathlib import Path

from scenarios.files.measured.record_file import read_record_file, with_names
from scenarios.preparation.drafting import Draft, drafted, map_text, vehicle_text
from scenarios.preparation.plan import plan_of
from scenarios.terminal.display_units import shown_in, unit_cell
from scenarios.terminal.paragraphs import terminal_width
from scenarios.terminal.tables import Column, table_lines
from sim.errors import DeclarationError

CHANNELS, VEHICLE = "channels.toml", "vehicle.toml"
SHOWN = 60  # characters of an expression


def draft_map(path: Path, out: Path | None, rate: float | None, columns: str | None, topics: bool) -> None:
    """Print the topics, the channels found with their ranges, every fault, and the draft; write it where ``out`` is given.

    Raises
    ------
    FlightidError : the file cannot be read; ``out`` holds a map or vehicle file already.
    """
    plan = plan_of(rate=rate, columns=columns)
    if out is not None:
        _refuse_present(out)
    draft = drafted(with_names(read_record_file(path), plan.columns), plan.rate)
    _print_topics(draft, whole=topics)
    _print_channels(draft)
    for fault in draft.faults:
        print(f"fault: {fault}")
    for note in draft.file.notes:
        print(f"note: {note}")
    if out is None:
        print(f"\n{map_text(draft)}", end="")
        print(f"\n{vehicle_text(draft)}", end="")
        return
    _write(out, draft)
    print(f"\n{out / CHANNELS}, {out / VEHICLE}: drafts to check and complete")
    if draft.model:
        # What opened the file here opens it there.
        opening = [f"--rate {rate:g}" if rate is not None else "--rate HZ" if draft.clockless else "", f"--columns {columns}" if columns else ""]
        words = " ".join(word for word in opening if word)
        files = f"--channels {out / CHANNELS} --vehicle {out / VEHICLE}"
        print(f"next: flightid identify {path} --model {draft.model} {files}{f' {words}' if words else ''}")


def _print_topics(draft: Draft, *, whole: bool) -> None:
    if len(draft.topics) == 1:
        (topic,) = draft.topics
        rate = f", {topic.rate:.4g} samples a second" if topic.rate else ""
        print(f"{draft.file.path.name}: {topic.rows} rows of {len(topic.columns)} columns{rate}")
        return
    print(f"{draft.file.path.name}: a log of {len(draft.topics)} topics")
    shown = draft.topics if whole else sorted(draft.topics, key=lambda topic: -topic.rows)[:15]
    _table(
        [
            Column("topic", [topic.name for topic in shown], left=True),
            Column("rows", [str(topic.rows) for topic in shown]),
            Column("Hz", [f"{topic.rate:.4g}" if topic.rate else "" for topic in shown]),
            Column("columns", [_short(", ".join(topic.columns), SHOWN) for topic in shown], left=True),
        ]
    )
    if len(shown) < len(draft.topics):
        print(f"{len(draft.topics) - len(shown)} smaller topics are not shown; --topics shows all")


def _print_channels(draft: Draft) -> None:
    from scenarios.files.channel_names import CHANNEL_UNITS

    usable = [guess for guess in draft.guesses if not guess.fault and guess.samples]
    if not usable:
        print("no channel was recognised by its name")
        return
    units = [shown_in(CHANNEL_UNITS[guess.channel], guess.channel) for guess in usable]
    _table(
        [
            Column("channel", [guess.channel for guess in usable], left=True),
            Column("from", [_short(str(guess.choice.column), SHOWN) for guess in usable], left=True),
            Column("samples", [str(guess.samples) for guess in usable]),
            Column("least", [f"{factor * guess.least:.4g}" for guess, (factor, _) in zip(usable, units, strict=True)]),
            Column("most", [f"{factor * guess.most:.4g}" for guess, (factor, _) in zip(usable, units, strict=True)]),
            Column("unit", [unit_cell(unit) for _, unit in units], left=True),
        ]
    )


def _table(columns: list[Column]) -> None:
    print("\n".join(f"  {line}" for line in table_lines(columns, width=terminal_width())))


def _refuse_present(out: Path) -> None:
    for name in (CHANNELS, VEHICLE):
        if (out / name).exists():
            raise DeclarationError("there is such a file already", where=str(out / name), remedy="name another folder with --out")


def _write(out: Path, draft: Draft) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / VEHICLE).write_text(vehicle_text(draft), encoding="utf-8", newline="\n")
        (out / CHANNELS).write_text(map_text(draft), encoding="utf-8", newline="\n")
    except OSError as error:
        raise DeclarationError(f"cannot be written ({error.strerror or error})", where=str(out), remedy="name another folder") from None


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."
