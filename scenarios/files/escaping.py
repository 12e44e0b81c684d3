"""Control characters that came with headers, names and files, shown instead of obeyed: at the
border where text leaves the program.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

# Besides the control characters proper: line separators, and marks that turn the direction of
# writing, by which a text shows other than it is.
_HIDDEN = (
    *range(0x20),
    *range(0x7F, 0xA0),
    0x2028,
    0x2029,
    *range(0x202A, 0x202F),
    *range(0x2066, 0x206A),
)
_SHOWN = {number: f"\\u{number:04x}" for number in _HIDDEN if chr(number) not in "\n\t"}


def escaped(text: str) -> str:
    """The text with every control character but line ends and tabs as ``\\u001b``, which JSON reads
    back as it was.
    """
    return text if text.isascii() and text.isprintable() else text.translate(_SHOWN)


class EscapedStream:
    """A text stream that escapes what is written; everything else is that of ``inner``."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def write(self, text: str) -> int:
        """Write the escaped text; the number of characters of the text itself."""
        self.inner.write(escaped(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each line escaped."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


@contextmanager
def escaped_streams() -> Iterator[None]:
    """Escape what is printed on stdout and stderr while the body runs."""
    out, err = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (None if each is None else cast(Any, EscapedStream(each)) for each in (out, err))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = out, err


def styled_stream(stream: Any) -> Any:
    """The stream below the escaping, for what writes styles of its own and escapes its texts
    itself.
    """
    return stream.inner if isinstance(stream, EscapedStream) else stream
