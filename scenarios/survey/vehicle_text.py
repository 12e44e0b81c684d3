"""A vehicle file with what one flight changes of it, as TOML."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any


def changed(content: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The content with ``changes`` in the place of its own; tables key by key."""
    both = {
        key: {**content[key], **value} if isinstance(value, dict) and isinstance(content.get(key), dict) else value for key, value in changes.items()
    }
    return {**content, **both}


def toml_text(content: Mapping[str, Any]) -> str:
    """TOML of what a TOML file held: a line a key, tables inline."""
    return "".join(f"{_text(key)} = {_inline(value)}\n" for key, value in content.items())


def _inline(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)  # inf and nan, too, are TOML
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_text(key)} = {_inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return _text(value) if isinstance(value, str) else json.dumps(value, default=str)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # what JSON and TOML write alike
