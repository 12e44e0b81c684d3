"""The thumbnails of the gallery: ``python docs/_ext/gallery_pictures.py`` writes ``docs/gallery``.

A scenario is shown by its flight, an effect by its signature: an output in a 3-2-1-1 without the
effect and with it, at its usual values.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parents[1] / "gallery"
WIDTH, HEIGHT, EDGE = 240.0, 120.0, 6.0  # px
POINTS = 160  # of a line
GREEN, GREY, BLUE = "#009e73", "#888888", "#0072b2"
# Model and vehicle of the library on which an effect is shown: the first on which it acts.
VEHICLES = {
    "rigid": "bomber_rigid",
    "lateral": "navion_lateral",
    "longitudinal": "navion_longitudinal",
}

# Effects that a designed 3-2-1-1 does not show, by the scenario whose flight does; with what is
# hidden in it where that is another effect.
FLIGHTS: dict[str, tuple[str, list[dict[str, Any]] | None]] = {
    "gust-turbulence": ("trace-turbulence", None),
    "missing-term": ("trace-aircraft", None),
    "drag-jump": ("trace-drag", None),
    "density-scale-height": ("trace-density", None),
    "drag-mach": ("trace-density", [{"name": "drag-mach", "values": {"shape1": 0.2}}]),
}


def thumbnail(rows: list[tuple[np.ndarray, str]], *, words: str) -> str:
    """Lines over the same time in one frame each above the other; those of one frame share it.

    ``rows``: values ``(k, N)``, lines of one frame, and the colour of the last; the others are
    grey.
    """
    height = (HEIGHT - EDGE) / len(rows)
    parts = []
    for number, (values, colour) in enumerate(rows):
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        span = (high - low) or 1.0
        top, room = EDGE + number * height, height - EDGE
        for order, line in enumerate(values):
            keep = np.unique(np.linspace(0, len(line) - 1, POINTS).round().astype(int))
            x = EDGE + (WIDTH - 2.0 * EDGE) * keep / max(len(line) - 1, 1)
            y = top + room * (high - line[keep]) / span
            points = " ".join(
                f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(b)
            )
            last = order == len(values) - 1
            parts.append(
                f'<polyline points="{points}" stroke="{colour if last else GREY}" '
                f'stroke-width="{1.4 if last else 2.2}"/>'
            )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{words}"><g fill="none" stroke-linejoin="round">{"".join(parts)}</g></svg>\n'
    )


def scenarios() -> Iterator[tuple[str, str]]:
    """Name and picture of each scenario that has a record: its first input and output."""
    import flightid as fid
    from scenarios.studies.catalogue import scenario_names

    for name in scenario_names():
        try:
            record = fid.simulate(name).record
        except fid.InputError:
            continue
        inputs, outputs = record.input_names[:1], record.output_names[:1]
        rows = [(record[each][None, :], GREEN) for each in inputs]
        rows += [(record[each][None, :], BLUE) for each in outputs]
        if rows:
            yield name, thumbnail(rows, words=f"{name}: {', '.join([*inputs, *outputs])} over time")


def effects() -> Iterator[tuple[str, str]]:
    """Name and signature of each effect that a simulation shows."""
    import flightid as fid
    from ident.maneuver_design import simulate_maneuver
    from scenarios.maneuver_design.setting import KINDS, DesignRequest, setting_of
    from sim.declaration.effect import NoiseEffect
    from sim.declaration.proposal import Traceable
    from sim.effects.library import effects_for
    from sim.errors import FlightidError

    done: set[str] = set()
    for model, vehicle in VEHICLES.items():
        source = fid.vehicle(vehicle).source_for(model)
        setting = setting_of(DesignRequest(model, source, duration=12.0, computer=True))
        shapes = KINDS["3-2-1-1"](setting.maneuver_limits, setting.maneuver_limits.pulse)
        assert shapes is not None
        size = np.array([*setting.limits.amplitude.values()])[:, None]
        planned = setting.planned(0.5 * size * shapes)
        plain = simulate_maneuver(planned, slopes=False).fit.linearisations[0].y
        for effect in effects_for(setting.model.equations):
            family = effect.name.partition(":")[0]
            if (
                family in done
                or isinstance(effect, NoiseEffect)
                or not isinstance(effect, Traceable)
            ):
                continue
            try:
                values = simulate_maneuver(planned, (effect,), slopes=False).fit.linearisations[0].y
            except FlightidError:
                continue
            change = np.max(np.abs(values - plain), axis=1) / np.array([*setting.noise.values()])
            worst = int(np.argmax(change))
            if not np.isfinite(change[worst]) or change[worst] < 0.5:
                continue
            done.add(family)
            output = planned.outputs[worst]
            pair = np.array([plain[worst], values[worst]])
            yield (
                family,
                thumbnail(
                    [(pair, BLUE), ((values - plain)[worst : worst + 1], GREEN)],
                    words=f"{family}: {output} of {model} without and with it, and the difference",
                ),
            )


def flown_effects() -> Iterator[tuple[str, str]]:
    """Name and signature of each effect of ``FLIGHTS``: one flight with it and without it, under
    the same noise.
    """
    import flightid as fid

    clean = {
        "hidden": [],
        "distance": "nothing missing",
        "expect.verdicts": ["consistent"],
        "expect.effects": [],
    }
    for family, (name, hidden) in FLIGHTS.items():
        changes = None if hidden is None else {"hidden": hidden}
        with_it = fid.simulate(name, set=changes).record
        without = fid.simulate(name, set=clean).record
        pairs = {each: np.array([without[each], with_it[each]]) for each in with_it.output_names}
        output = max(
            pairs, key=lambda each: np.ptp(np.diff(pairs[each], axis=0)) / np.ptp(pairs[each][0])
        )
        pair = pairs[output]
        yield (
            family,
            thumbnail(
                [(pair, BLUE), (np.diff(pair, axis=0), GREEN)],
                words=f"{family}: {output} of {name} without and with it, and the difference",
            ),
        )


def main(words: list[str] | None = None) -> None:
    """Write the pictures, and take away those that are no longer made."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args(words)
    made: dict[str, Any] = {f"scenario-{name}": svg for name, svg in scenarios()}
    made |= {f"effect-{name}": svg for name, svg in (*effects(), *flown_effects())}
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.svg"):
        if old.stem not in made:
            old.unlink()
    for stem, svg in made.items():
        (FOLDER / f"{stem}.svg").write_text(svg, encoding="utf-8")
    print(f"{len(made)} pictures in {FOLDER}")


if __name__ == "__main__":
    main()
