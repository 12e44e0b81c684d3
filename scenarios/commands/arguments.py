"""Arguments as they are typed, made into those that the command-line library understands."""

from __future__ import annotations

SEVERAL = {"diagnose": ("--validate",), "identify": ("--validate", "--profile")}  # options that take every word up to the next option
NONE_MEANS = {"--profile": "all"}  # what such an option without a word stands for
FLAGS = ("--figures", "--no-figures", "--trust-record")
BAND = ("--band",)  # options of two words
FILES = (".csv", ".parquet", ".mat", ".tsv", ".txt")  # ends of what is a record and no parameter


def each_validated(given: list[str]) -> list[str]:
    """``--validate A B`` as ``--validate A --validate B``, and so ``--profile``: they take every word up to the next option, as documented.

    Where that would leave no record to fit, ``--validate`` takes one file only. ``--profile`` takes no record, and alone means all parameters.
    """
    several = SEVERAL.get(given[0], ()) if given else ()
    if not several:
        return given
    out, option, taken, fitted = [given[0]], "", 0, 0
    for text in given[1:]:
        if text.startswith("-") and text != "-":
            out += _unsaid(option, taken)
            option, taken = text, 0
            out.append(text)
            continue
        if option in several and not (option == "--profile" and text.lower().endswith(FILES)):
            out += [text] if taken == 0 else [option, text]
            taken += 1
            continue
        wanted = 0 if option in ("", *FLAGS, *several) or "=" in option else 2 if option in BAND else 1
        if taken >= wanted:
            out += _unsaid(option, taken)
            fitted += 1
            option, taken = ("", 0) if option in several else (option, taken)
        else:
            taken += 1
        out.append(text)
    out += _unsaid(option, taken)
    return out if fitted else given


def _unsaid(option: str, taken: int) -> list[str]:
    """What an option means that was given no word."""
    return [NONE_MEANS[option]] if option in NONE_MEANS and taken == 0 else []
