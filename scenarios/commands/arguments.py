"""Arguments as they are typed, made into those that the command-line library understands."""

from __future__ import annotations


def each_validated(given: list[str]) -> list[str]:
    """``--validate A B`` as ``--validate A --validate B``: the option takes every file up to the next option, as it is documented.

    Where that would leave no record to fit, it takes one file only.
    """
    if given[:1] != ["diagnose"]:
        return given
    out, taking, fitted = [], 0, 0
    for place, text in enumerate(given[1:], start=1):
        option = text.startswith("-") and text != "-"
        if not option and taking > 1:
            out += ["--validate", text]
            continue
        out.append(text)
        if option:
            taking = 1 if text == "--validate" else 0
        elif taking == 1:
            taking = 2
        elif not given[place - 1].startswith("--") or given[place - 1] in ("--figures", "--no-figures", "--trust-record"):
            fitted += 1
    return ["diagnose", *out] if fitted else given
