"""Pages of the catalogue: a table of all scenarios, and one page each with its file."""

from __future__ import annotations

import tomllib

from docs._ext.made.markdown import cell, fenced, paragraph, table

KIND = {
    "identification": "Simulated, identified, compared",
    "trace": "Something hidden, to be traced",
    "x29": "Closed loop of the X-29",
    "sweep": "Swept in flight: response, model, margins",
    "jsbsim": "Flown by JSBSim",
}


def scenarios_page() -> str:
    """All scenarios by kind, and the keys that the file of each sets."""
    from scenarios.studies.catalogue import KINDS, scenario_names, scenario_title

    parts = [
        "# Scenarios of the catalogue\n",
        "Made from `scenarios/catalog`. `flightid run NAME` runs one, `flightid list NAME > mine.toml` copies its file. What the keys mean: "  # noqa: E501
        "[scenario files](../scenarios.md).\n",
    ]
    for kind in KINDS:
        rows = (
            [f"[`{name}`](scenario/{name}.md)", cell(scenario_title(name))]
            for name in scenario_names(kind)
        )
        parts += [f"## {KIND.get(kind, kind)}\n", table(["scenario", "what it is"], rows)]
    return "\n".join(parts)


def scenario_pages() -> dict[str, str]:
    """Name of a page -> its text, for every scenario."""
    from scenarios.studies.catalogue import scenario_names, scenario_text

    pages = {}
    for name in scenario_names():
        text = scenario_text(name)
        document = tomllib.loads(text)
        tables = [key for key, value in document.items() if isinstance(value, dict | list)]
        about = "\n\n".join(
            paragraph(each) for each in str(document.get("about", "")).strip().split("\n\n")
        )
        distance = (
            f"Distance of truth and declared model: {paragraph(str(document['distance']))}.\n"
            if "distance" in document
            else ""
        )
        keys = f"Its tables: {', '.join(f'`{key}`' for key in tables)}; " if tables else ""
        pages[f"scenario/{name}"] = "\n".join(
            [
                f"# {name}\n",
                paragraph(str(document["title"])).capitalize() + ".\n",
                fenced("text", f"flightid run {name} --out study"),
                about + "\n",
                distance,
                f"{keys}every key is explained under [scenario files](../../scenarios.md).\n",
                fenced("toml", text),
            ]
        )
    return pages
