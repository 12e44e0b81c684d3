"""The page of built-in vehicles."""

from __future__ import annotations

from docs._ext.made.markdown import cell, code, paragraph, table


def vehicles_page() -> str:
    """Every number of every vehicle, with unit, print and origin."""
    from sim.vehicles.library import read_parameter_set, vehicle_names

    sets = [read_parameter_set(name) for name in vehicle_names()]
    parts = [
        "# Vehicles\n",
        "Made from the data files in `sim/data`, one a source; `flightid vehicles NAME` prints one, "  # noqa: E501
        "`flightid vehicles NAME --diff OTHER` what differs.\n",
        table(
            ["vehicle", "what", "equations"],
            (
                [f"[`{data.name}`](#{data.name})", cell(data.title), code(data.equations)]
                for data in sets
            ),
        ),
    ]
    for data in sets:
        based = f" Based on `{data.based_on}`." if data.based_on else ""
        rows = (
            [code(n.name), f"{n.value:.7g}", cell(n.unit), cell(n.printed), cell(n.source)]
            for n in (*data.numbers, *data.initial)
        )
        parts += [
            f"## {data.name}\n",
            f"{paragraph(data.title)}. Source: {paragraph(data.source)}{based}\n",
            table(["parameter", "value", "unit", "as printed", "origin"], rows),
        ]
    return "\n".join(parts)
