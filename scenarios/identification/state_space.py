"""An identified model as matrices: about which point it is linearised, and the file that holds
them.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ident.flying_qualities.modes import LONGITUDINAL_STATES, StateSpace, level_flight, state_space
from scenarios.files.measured.columns import sidecar_path
from scenarios.files.sources import resolved
from scenarios.files.user_models import inputs_at_rest
from scenarios.files.writing import write_content
from scenarios.identification.assessment import IdentificationResult
from sim.declaration.model import Model, System
from sim.errors import DeclarationError, FlightidError
from sim.record import Record

SCHEMA = "flightid/state-space/1"
NEIGHBOURS = 11  # samples whose slope is the velocity of a falling body


def state_space_of(found: IdentificationResult) -> StateSpace:
    """The identified model as ``linearised``."""
    assert found.system is not None
    return linearised(found.system, found.estimate.as_dict(), found.record, found.vehicle.own)


def linearised(
    system: System, values: Mapping[str, float], record: Record, own: Model | None = None
) -> StateSpace:
    """A model about level flight where it has totals, about rest elsewhere, of a falling body about
    the middle of its record.

    ``own``: a user's own model, which says itself where it rests. Raises DeclarationError where
    there is no such point.
    """
    names = set(system.state_names)
    if names.issuperset(LONGITUDINAL_STATES):
        p = system.parameters.with_values(
            {name: value for name, value in values.items() if name in system.parameters}
        ).values()
        level = level_flight(system, p)
        if level is None:
            what = "the identified model has no level flight at its reference airspeed"
            raise DeclarationError(
                what, where="--state-space", remedy="fit a record that tells elevator and lift"
            )
        return state_space(system, values, *level)
    if own is not None:
        return state_space(system, values, own.initial.values().tolist(), inputs_at_rest(own))
    if "altitude" in names:
        return state_space(system, values, [_middle(record)[name] for name in system.state_names])
    return state_space(system, values)


def _middle(record: Record) -> dict[str, float]:
    """Altitude and velocity of a falling body in the middle of its record, by a straight line
    through its neighbours.
    """
    channel = record["altitude"]
    t, h = record.time[channel.valid], channel.values[channel.valid]
    first = max(0, (len(t) - NEIGHBOURS) // 2)
    near = slice(first, first + NEIGHBOURS)
    at = float(t[near].mean())
    velocity, altitude = np.polyfit(t[near] - at, h[near], 1)
    return {"altitude": float(altitude), "velocity": float(velocity)}


def state_space_content(space: StateSpace) -> dict[str, Any]:
    """What a JSON file holds: matrices as rows, signals with units, the point, roots of A."""
    roots = space.eigenvalues
    return {
        "schema": SCHEMA,
        **{name: getattr(space, name).tolist() for name in "ABCD"},
        **{
            kind: [{"name": s.name, "unit": s.unit} for s in getattr(space, kind)]
            for kind in ("states", "inputs", "outputs")
        },
        "about": {name: getattr(space, name).tolist() for name in ("x0", "u0", "y0", "rates")},
        "delays": dict(space.delays),
        "left_out": list(space.left_out),
        "eigenvalues": [[float(root.real), float(root.imag)] for root in roots],
    }


def _json(space: StateSpace) -> bytes:
    return (json.dumps(state_space_content(space), indent=2, allow_nan=False) + "\n").encode()


def _arrays(space: StateSpace) -> dict[str, Any]:
    """Matrices, names and units as arrays; rows of names as the columns and rows of the
    matrices.
    """
    signals = {
        f"{kind}_{what}": np.array([getattr(s, what[:-1]) for s in getattr(space, kind)], dtype=str)
        for kind in ("states", "inputs", "outputs")
        for what in ("names", "units")
    }
    delays = np.array([space.delays.get(s.name, 0.0) for s in space.inputs])
    return {
        **{name: getattr(space, name) for name in (*"ABCD", "x0", "u0", "y0", "rates")},
        **signals,
        "delays": delays,
    }


def _npz(space: StateSpace) -> bytes:
    to = io.BytesIO()
    np.savez(to, **_arrays(space))
    return to.getvalue()


def _mat(space: StateSpace) -> bytes:
    from scipy.io import savemat

    cells = {
        name: value.astype(object) if value.dtype.kind == "U" else value
        for name, value in _arrays(space).items()
    }
    to = io.BytesIO()
    savemat(to, cells, oned_as="column")
    return to.getvalue()


FORMATS: Mapping[str, Callable[[StateSpace], bytes]] = MappingProxyType(
    {".json": _json, ".mat": _mat, ".npz": _npz}
)


def refuse_place(path: Path, kept: Iterable[Path] = ()) -> None:
    """Raise DeclarationError for an ending that no format has, for a folder, and for one of the
    files ``kept`` or what stands beside a record.
    """
    where = f"--state-space, {path}"
    if path.suffix.lower() not in FORMATS:
        what = f"{path.suffix or 'no'} ending"
        raise DeclarationError(
            what, where=where, remedy=f"name a file that ends in {', '.join(FORMATS)}"
        )
    if path.is_dir():
        raise DeclarationError("this is a folder", where=where, remedy="name a file")
    if resolved(path) in {
        resolved(each) for given in kept for each in (given, sidecar_path(given))
    }:
        raise DeclarationError(
            "the matrices would take the place of a record or of the study",
            where=where,
            remedy="name another file",
        )


def write_state_space(space: StateSpace, path: Path) -> None:
    """Write the matrices in the format of the file's ending; a JSON file is text, the others are
    arrays by name.
    """
    refuse_place(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_content(path, FORMATS[path.suffix.lower()](space))
    except OSError as error:
        raise FlightidError(
            f"cannot be written ({error.strerror})",
            where=str(path),
            remedy="name a file that you may write",
        ) from None
