"""The page of commands, from what `scenarios/cli.py` declares."""

from __future__ import annotations

from typing import Any

from docs._ext.made.markdown import cell, code, table


def commands_page() -> str:
    """Every command: what it does, what it takes."""
    from typer.main import get_command

    from scenarios.cli import app

    whole: Any = get_command(app)
    visible = {name: command for name, command in whole.commands.items() if not command.hidden}
    parts = [
        "# Command line\n",
        "Made from the declaration of the commands; `flightid COMMAND --help` says the same. Exit code 0: done; 2: bad usage or bad input, "  # noqa: E501
        "with one line that names the file, the place and the remedy; 1: anything else.\n",
        table(
            ["command", "does"],
            (
                [f"[`flightid {name}`](#flightid-{name})", cell(first_line(command))]
                for name, command in visible.items()
            ),
        ),
        "Options of every command stand before it:\n",
        options_table(whole),
    ]
    for name, command in visible.items():
        parts += [
            f"## flightid {name}\n",
            f"```text\nflightid {usage(name, command)}\n```\n",
            described(command),
            options_table(command),
        ]
    return "\n".join(parts)


def first_line(command: Any) -> str:
    return str(command.help or "").strip().split("\n\n")[0]


def described(command: Any) -> str:
    """The help text; what is indented or of several short lines stays as it is."""
    text = str(command.help or "").replace("\b", "").strip()
    head, *rest = text.split("\n\n")
    parts = [cell(head) + "\n"]
    for each in rest:
        lines = each.strip("\n").splitlines()
        parts.append(
            "```text\n" + "\n".join(lines) + "\n```\n"
            if any(line.startswith(" ") for line in lines)
            else cell(each) + "\n"
        )
    return "\n".join(parts)


def usage(name: str, command: Any) -> str:
    """Name and arguments; required options too."""
    taken = [
        item for item in command.params if getattr(item, "required", False) or is_argument(item)
    ]
    words = []
    for item in sorted(taken, key=lambda item: not is_argument(item)):
        value = item.metavar or item.name.upper()
        words.append(
            (value if item.required else f"[{value}]")
            if is_argument(item)
            else f"{item.opts[0]} {value}"
        )
    return " ".join([name, *words, "[OPTIONS]"])


def is_argument(item: Any) -> bool:
    return not item.opts[0].startswith("-")


def options_table(command: Any) -> str:
    """Arguments and options with what they mean; what is not listed by help is left out here too."""  # noqa: E501
    rows = []
    for item in command.params:
        if getattr(item, "hidden", False) or item.name == "help":
            continue
        value = (
            ""
            if is_argument(item) or getattr(item, "is_flag", False)
            else f" {item.metavar or item.type.name.upper()}"
        )
        names = ", ".join(code(f"{each}{value}") for each in item.opts)
        if is_argument(item):
            names = code(item.metavar or item.name.upper())
        names += "".join(f", {code(each)}" for each in item.secondary_opts)
        rows.append([names, cell(getattr(item, "help", None) or ""), shown(item)])
    return table(["argument or option", "what", "left out"], rows)


def shown(item: Any) -> str:
    """The value that an option has where it is left out, nothing for those without one."""
    value = item.default
    if item.required:
        return "required"
    if value is None or callable(value) or value in (False, (), [], ""):
        return ""
    return code(item.opts[0] if value is True else getattr(value, "value", value))
