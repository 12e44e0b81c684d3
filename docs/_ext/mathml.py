"""Equations of the pages as MathML: browsers draw it themselves, without a script and off line.

The font is STIX Two Math as the package ziamath carries it (SIL Open Font License), cut down to
what equations use.
"""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

FONT = "stix-two-math.woff"
# Latin, Greek, modifiers and combining marks, punctuation, arrows to technical signs, shapes,
# arrows, mathematical letters.
RANGES = (
    (0x20, 0x17F),
    (0x2C0, 0x36F),
    (0x370, 0x3FF),
    (0x2000, 0x23FF),
    (0x25A0, 0x25FF),
    (0x27C0, 0x2BFF),
    (0x1D400, 0x1D7FF),
)


def mathml(latex: str, block: bool) -> str:
    """One equation. Raises what latex2mathml raises where it cannot read it; the build ends
    there.
    """
    text = convert(latex.strip(), display="block" if block else "inline")
    # Dots and bars are accents, which stand close and over the middle of a slanted letter; Greek
    # capitals stand upright as in print.
    text = re.sub(
        r"<mover>(?=(?:<mi>[^<]*</mi>|<msub>.*?</msub>)<mo[^>]*>&#x00(?:2D9|0A8|0AF);</mo></mover>)",
        '<mover accent="true">',
        text,
    )
    return re.sub(r"<mi>(&#x0039[1-9A-F]|&#x003A[0-9]);", r'<mi mathvariant="normal">\1;', text)


def visit_math(translator: Any, node: nodes.math) -> None:
    translator.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(
        f'<div class="math-block" tabindex="0">{mathml(node.astext(), block=True)}</div>\n'
    )
    raise nodes.SkipNode


def write_font(app: Any, error: Exception | None) -> None:
    """Put the font among the site's static files."""
    if error is not None or app.builder.format != "html":
        return
    from fontTools import subset

    package = find_spec("ziamath")
    if package is None or package.origin is None:
        raise ImportError(
            "the font of equations comes with ziamath: python -m pip install -e '.[docs]'"
        )
    options = subset.Options(flavor="woff", layout_features=["*"], notdef_outline=True)
    font = subset.load_font(
        str(Path(package.origin).parent / "fonts" / "STIXTwoMath-Regular.ttf"), options
    )
    cut = subset.Subsetter(options)
    cut.populate(unicodes=[point for first, last in RANGES for point in range(first, last + 1)])
    cut.subset(font)
    target = Path(app.outdir) / "_static" / FONT
    target.parent.mkdir(parents=True, exist_ok=True)
    subset.save_font(font, str(target), options)


def setup(app: Any) -> dict[str, object]:
    """Sphinx's hook of an extension."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
    app.config.html_math_renderer = "mathml"
    app.connect("build-finished", write_font)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
