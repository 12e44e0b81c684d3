"""How the site is built from these pages; docs/README.md has the command. No network is asked for
anything.
"""

import os
import sys
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

project = "flightid"
author = "flightid contributors"
copyright = author
try:
    release = metadata.version("flightid")
except metadata.PackageNotFoundError:
    release = ""

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "docs._ext.site",
    "docs._ext.references",
    "docs._ext.faster",
    "docs._ext.mathml",
    "docs._ext.docstrings",
]
root_doc = "index"
exclude_patterns = ["_ext", "README.md"]
# Annotations name a class by itself, and two packages may each have one of that name: such a name
# is then shown without a link.
suppress_warnings = ["ref.python"]

# Pages are Markdown as code hosts read it: equations between dollars, links to files and to
# headings by their slugs.
myst_enable_extensions = ["dollarmath", "deflist"]
myst_dmath_double_inline = True
myst_dmath_allow_space = False
myst_dmath_allow_digits = False
myst_heading_anchors = 4
myst_links_external_new_tab = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# Both read the source of each function again, which was a sixth of the time of a build.
autodoc_preserve_defaults = False
autodoc_use_type_comments = False
# Of optional extras: the site needs none of them.
autodoc_mock_imports = ["jsbsim", "marimo", "playwright", "pyarrow"]
add_module_names = False
toc_object_entries = False
python_maximum_signature_line_length = 100
highlight_language = "text"
copybutton_prompt_text = "$ "

# What the pages themselves do not say: which page stands under which, in which order. A star takes
# what is not named before it.
contents = {
    "index": [
        "start",
        "made/gallery",
        "how-to/README",
        "theory",
        "reference",
        "results",
        "limits",
        "platforms",
        "made/labs/README",
        "made/changelog",
        "developers",
    ],
    "developers": [
        "architecture",
        "tracing-details",
        "decisions/README",
        "made/contributing",
        "made/api/README",
    ],
    "how-to/README": [
        "how-to/your-recorder",
        "how-to/own-record",
        "how-to/estimate",
        "how-to/maneuvers",
        "how-to/frequency-responses",
        "how-to/ardupilot-sweep",
        "how-to/own-flight-data",
        "how-to/lateral-and-longitudinal",
        "six-degrees",
        "own-models",
        "how-to/own-effect",
        "how-to/*",
    ],
    "theory": ["estimators", "tracing", "compatibility", "recording"],
    "reference": [
        "made/commands",
        "scenarios",
        "made/scenarios",
        "made/effects",
        "made/models",
        "made/vehicles",
        "nomenclature",
        "made/names",
        "made/python",
    ],
    "results": [
        "papers",
        "phase-margin",
        "tracing-performance",
        "campaign-statistics",
        "performance",
        "records/README",
    ],
    "records/README": ["records/*"],
    "decisions/README": ["decisions/*"],
    "made/labs/README": ["made/labs/*"],
}

html_theme = "pydata_sphinx_theme"
html_title = f"flightid {release}".strip()
# Pages with nothing below them have no navigation of their own section.
html_sidebars = {
    name: []
    for name in (
        "index",
        "start",
        "limits",
        "made/gallery",
        "made/changelog",
        "search",
        "genindex",
        "py-modindex",
    )
}
html_static_path = ["_static"]
html_search_scorer = str(ROOT / "docs" / "_static" / "scorer.js")
html_css_files = ["site.css", "math.css"]
html_show_sourcelink = False
html_copy_source = False
# it fetches pages, which browsers forbid where the site is opened as files
html_show_search_summary = False
html_context = {"default_mode": "auto"}
# The address at which a page is edited, with {page} for its path below docs: where the sources are
# hosted is not known here. Without it pages have no link to it.
edit_address = os.environ.get("FLIGHTID_EDIT_PAGE", "")
if edit_address:
    html_context["edit_page_url_template"] = edit_address.replace("{page}", "{{ file_name }}")
html_theme_options = {
    "logo": {"text": "flightid"},
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc", *(["edit-this-page"] if edit_address else [])],
    "use_edit_page_button": bool(edit_address),
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
}
