"""Lab 9: maneuvers of an aircraft whose coefficients are nonlinear, and the terms that stepwise
regression finds in them.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from flightid.labs.workings import KEPT

if TYPE_CHECKING:
    from scenarios.structure import FoundStructure
    from sim.record import Record
    from sim.vehicles.aircraft import Aircraft

KINDS = ("pulses one after the other", "multisines at once")
MOST = 6  # maneuvers that may be fitted; one more is never fitted
RATE, DURATION = 25.0, 16.0  # samples a second, s
NOISE = {
    "airspeed": 0.1,
    "alpha": 6e-4,
    "beta": 6e-4,
    **dict.fromkeys(("p", "q", "r"), 6e-4),
    **dict.fromkeys(("phi", "theta"), 1e-3),
    **dict.fromkeys(("ax", "ay", "az"), 0.02),
}
AXES = ("Cm", "Cn", "Cl", "CL", "CY", "CD")
HIDDEN = {"Cm": {"alpha*elevator": 5.0}, "Cl": {"alpha*beta": -0.9}}  # invented terms
FOLLOWS, OWN = 0.6, 0.02  # shares of aileron and of its own movement in a rudder that is linked
_SIZES = (1.0, -0.75, 1.2, -1.1, 0.85, -0.9, 1.0)  # relative sizes of the pulses of each maneuver
_STRETCH = (1.0, 1.25, 0.85, 1.1, 0.75, 1.35, 1.0)  # relative durations


@dataclass(frozen=True, eq=False)
class Studied:
    """Terms found from some maneuvers, the aircraft that flew them, and R2 on one not fitted.

    Attributes
    ----------
    found : terms, steps and collinearity of each coefficient.
    true : the aircraft.
    records : the maneuvers fitted.
    held_out : the one that never is.
    """

    found: FoundStructure
    true: Aircraft
    records: tuple[Record, ...]
    held_out: Record

    def predicted(self, axis: str) -> float:
        """Return R2 of a coefficient on the maneuver that is never fitted."""
        return self.found.predicted[self.held_out.name][axis]


@cache
def aircraft() -> Aircraft:
    """Return the true aircraft: the generic airliner with products of two signals as terms."""
    from scenarios.files.aircraft_files import example
    from sim.aerodynamics import parse_term
    from sim.vehicles.aircraft import declaration_of

    plain = declaration_of(example())
    assert plain is not None
    further = {
        axis: {parse_term(text, plain.signals): value for text, value in terms.items()}
        for axis, terms in HIDDEN.items()
    }
    terms = {axis: {**own, **further.get(axis, {})} for axis, own in plain.coefficients.items()}
    return replace(plain, coefficients=terms, biases=())


def true_terms(axis: str) -> dict[str, float]:
    """Return terms of a coefficient and their true values."""
    return {term.text: value for term, value in aircraft().coefficients[axis].items()}


def _deflections(kind: str, linked: bool, number: int) -> np.ndarray:
    """Return the elevator, aileron, rudder (rad) and thrust (N) at the samples, ``(4, N)``, held
    between them; ``number`` counts maneuvers from 0.
    """
    from sim.maneuvers import Maneuver, doublet, orthogonal_multisines, three_two_one_one
    from sim.truth.flight import sample_times

    time = sample_times(RATE, DURATION)
    size, stretch = _SIZES[number], _STRETCH[number]
    parts: Sequence[tuple[Maneuver, ...]]
    if kind == KINDS[0]:
        parts = (
            (
                three_two_one_one(0.06 * size, _on_samples(0.6 * stretch), 1.0),
                doublet(-0.05 * size, _on_samples(0.9 * stretch), 12.0),
            ),
            (doublet(0.06 * size, _on_samples(0.9 * stretch), 6.0),),
            (doublet(0.06 * size, _on_samples(1.1 * stretch), 9.0),),
        )
    else:
        rms, turn = [0.025 * abs(size)] * 3, number % 3
        waves = orthogonal_multisines(rms, DURATION, 2 + turn, 14 + 2 * turn)
        parts = tuple((wave,) for wave in waves)
    moved = [np.sum([part(time) for part in surface], axis=0) for surface in parts]
    if linked:
        moved[2] = FOLLOWS * moved[1] + OWN * moved[2]
    moved[0] = moved[0] + aircraft().start["elevator"]
    return np.array([*moved, np.full(len(time), aircraft().start["thrust"])])


def _on_samples(duration: float) -> float:
    """Return the duration, s, in whole samples: a switch between two would be recorded late."""
    return round(RATE * duration) / RATE


@cache
def _motion() -> Mapping[tuple[str, bool, int], tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Return inputs ``(4, N)`` and outputs ``(N,)`` by name of all maneuvers, simulated side by
    side.
    """
    from sim.declaration.compile import compile_model
    from sim.propagation import Drive, make_grid, outputs_at_samples, propagate
    from sim.truth.flight import sample_times
    from sim.vehicles.aircraft import aircraft_model

    every = [
        (kind, linked, number)
        for kind in KINDS
        for linked in (False, True)
        for number in range(MOST + 1)
    ]
    u = np.stack([_deflections(*each) for each in every], axis=-1)
    system = compile_model(aircraft_model(aircraft()))
    grid = make_grid(sample_times(RATE, DURATION), 1.0 / RATE)
    held = [row[grid.source] for row in u]
    drive = Drive((held, held, held), [row[grid.sample] for row in u], held)
    p, start = system.parameters.values().tolist(), system.initial.values().tolist()
    states = propagate(system, p, start, drive, grid)
    outputs = outputs_at_samples(system, p, states, drive, grid)
    return {
        each: (
            u[..., at],
            {name: row[:, at] for name, row in zip(system.output_names, outputs, strict=True)},
        )
        for at, each in enumerate(every)
    }


@lru_cache(KEPT)
def flown(kind: str, linked: bool, noise: float, number: int) -> Record:
    """Return a maneuver measured with ``noise`` times the usual noise; ``number`` counts from 0."""
    from sim.record import Channel, Hold, Record
    from sim.truth.flight import sample_times
    from sim.truth.measurement import Measurement, measure
    from sim.vehicles.aircraft import OUTPUTS

    u, rows = _motion()[kind, linked, number]
    std = {name: noise * value for name, value in NOISE.items()}
    rng = np.random.default_rng(100 + number)
    time = sample_times(RATE, DURATION)
    units = {**aircraft().surfaces, "thrust": "N"}
    return Record(
        time,
        tuple(Channel.of(*each, row) for each, row in zip(units.items(), u, strict=True)),
        measure(time, rows, OUTPUTS, rng, Measurement(std=std)),
        Hold.PREVIOUS,
        f"maneuver_{number + 1}.csv" if number < MOST else "not_fitted.csv",
    )


@lru_cache(KEPT)
def study(
    maneuvers: int = 3,
    kind: str = KINDS[0],
    linked: bool = False,
    noise: float = 1.0,
    degree: int = 2,
) -> Studied:
    """Return terms of all coefficients from some maneuvers.

    Parameters
    ----------
    maneuvers : 1 to ``MOST``.
    kind : of ``KINDS``.
    linked : the rudder follows the aileron.
    noise : of all sensors, times the usual.
    degree : of the products of signals offered.
    """
    from scenarios.structure import StructureOptions, predicted_r2, structure_of

    records = tuple(flown(kind, linked, noise, number) for number in range(maneuvers))
    held_out = flown(kind, False, noise, MOST)
    found = structure_of(records, aircraft(), StructureOptions(degree=int(degree)))
    found = replace(found, predicted=predicted_r2(found, [held_out]))
    return Studied(found, aircraft(), records, held_out)


def variance(studied: Studied, axis: str) -> float:
    """Return the variance of a measured coefficient over the maneuvers that are fitted."""
    return float(np.var(np.concatenate([h.coefficients[axis] for h in studied.found.histories])))


def shown(studied: Studied, axis: str) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the time, measured and modelled coefficient, each ``(M,)``: of the last maneuver that
    is fitted and of the one that never is.
    """
    from scenarios.structure import coefficients_of

    found, terms = studied.found, studied.found.selections[axis].table
    drawn = {}
    for text, history in (
        ("last fitted maneuver", found.histories[-1]),
        ("maneuver not fitted", coefficients_of(studied.held_out, studied.true)),
    ):
        model = sum(value * history.column(term, axis) for term, value in terms.items())
        drawn[text] = (history.time, history.coefficients[axis], np.asarray(model))
    return drawn


def term_rows(studied: Studied, axis: str) -> list[list[str]]:
    """Return rows of a table: term, true value, estimate; number, F ratio, R2 left out and
    predicted squared error of the step that added the term; variance inflation. True terms that
    were not chosen are last.
    """
    each, together = studied.found.selections[axis], studied.found.collinearity[axis]
    true = true_terms(axis)
    steps = {
        step.term: [
            str(number),
            f"{step.F:.0f}",
            f"{step.held_out:.4f}" if np.isfinite(step.held_out) else "",
            f"{step.pse:.3g}",
        ]
        for number, step in enumerate(each.steps, 1)
        if step.added
    }
    inflation = dict(zip(together.terms, together.inflation.tolist(), strict=True))
    rows = [
        [
            f"`{term.text}`",
            f"{true.get(term.text, 0.0):.4g}",
            f"{value:.4g} ± {sigma:.2g}",
            *steps.get(term, [""] * 4),
            f"{inflation[term]:.1f}" if term in inflation else "",
        ]
        for term, value, sigma in zip(each.terms, each.values, each.sigma, strict=True)
    ]
    chosen = {term.text for term in each.terms}
    missing = [text for text in true if text not in chosen]
    return rows + [[f"`{text}`", f"{true[text]:.4g}", "not chosen", *[""] * 5] for text in missing]


def held_out(studied: Studied, axis: str) -> str:
    """Return R2 on maneuvers left out in turn as text; words for a single maneuver."""
    value = studied.found.selections[axis].held_out
    return f"{value:.4f}" if np.isfinite(value) else "none of one maneuver"


def told(studied: Studied, axis: str) -> list[str]:
    """Return the command's sentences on a coefficient and on surfaces that move together."""
    from scenarios.structure_report import findings

    lines = findings(studied.found)
    advice = studied.found.collinearity[axis].advice
    return [
        line
        for line in lines
        if line.startswith((f"{axis}:", f"{axis} lacks"))
        or "move together" in line
        or any(line == f"To separate {each}." for each in advice)
    ]


def key_numbers(
    axis: str = "Cm",
    maneuvers: int = 3,
    kind: str = KINDS[0],
    linked: bool = False,
    noise: float = 1.0,
    degree: int = 2,
) -> dict[str, float]:
    """Return the numbers of the key for a coefficient: numbers of chosen and of true terms, R2 on
    maneuvers left out in turn (zero for a single maneuver) and on the maneuver that is never
    fitted, residual over noise, largest variance inflation, largest condition index.
    """
    studied = study(maneuvers, kind, linked, noise, degree)
    each, together = studied.found.selections[axis], studied.found.collinearity[axis]
    true = true_terms(axis)
    chosen = {term.text for term in each.terms if term.factors}
    return {
        "terms": float(len(chosen)),
        "true terms": float(len(chosen & set(true))),
        "R2 left out": each.held_out if np.isfinite(each.held_out) else 0.0,
        "R2 not fitted": studied.predicted(axis),
        "residual/noise": each.ratio,
        "VIF": float(np.max(together.inflation, initial=1.0)),
        "condition index": float(np.max(together.indices, initial=1.0)),
    }


def maneuvers_needed(text: str, axis: str, noise: float) -> int:
    """Return the least number of maneuvers with multisines that find a term; ``MOST + 1`` if none
    does.
    """
    for count in range(1, MOST + 1):
        found = study(count, KINDS[1], False, noise).found.selections[axis]
        if text in {term.text for term in found.terms}:
            return count
    return MOST + 1


def command(maneuvers: int, degree: int) -> str:
    """Return the command line for the files of ``archive``."""
    names = " ".join(f"maneuver_{number + 1}.csv" for number in range(maneuvers))
    return (
        f"flightid structure {names} \\\n  --vehicle vehicle.toml --degree {degree} "
        "\\\n  --validate not_fitted.csv"
    )


def archive(studied: Studied) -> bytes:
    """Return a ZIP file with the records and a vehicle file without terms."""
    import tempfile
    from pathlib import Path

    from flightid.labs.workings import PREFIX
    from scenarios.files.aircraft_files import vehicle_file_text
    from scenarios.files.writing import write_record
    from sim.aerodynamics import Term

    plain = {axis: {Term(): 0.0} for axis in studied.true.coefficients}
    out = io.BytesIO()
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch, zipfile.ZipFile(out, "w") as packed:
        for record in (*studied.records, studied.held_out):
            write_record(Path(scratch), record, Path(record.name).stem, simulated=True)
        for path in sorted(Path(scratch).iterdir()):
            packed.write(path, path.name)
        packed.writestr(
            "vehicle.toml", vehicle_file_text(replace(studied.true, coefficients=plain))
        )
    return out.getvalue()
