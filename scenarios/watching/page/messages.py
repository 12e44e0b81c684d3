"""What rows, estimates and the end of a watch look like as events: one line of strict JSON each."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from scenarios.terminal.quantities import CHANNELS, DEGREES, number_text
from scenarios.watching.rows import OUTPUTS
from scenarios.watching.session import UNITS, Step
from scenarios.watching.table import HANGING, WORDS, CrossValidation

FACTOR = {name: math.degrees(1.0) if UNITS[name] in DEGREES else 1.0 for name in OUTPUTS}


def about(name: str, stick_unit: str, delays: np.ndarray, reference: str | None, start: str) -> str:
    """What does not change: names and units of the strips, the delays (ms), the study that is compared with."""
    strips = [{"name": "stick", "word": "stick", "unit": "" if stick_unit == "1" else stick_unit}]
    strips += [{"name": each, "word": CHANNELS[each], "unit": DEGREES.get(UNITS[each], UNITS[each])} for each in OUTPUTS]
    return _line({"name": name, "strips": strips, "delays": (1000.0 * delays).tolist(), "reference": reference, "start": start})


def rows(steps: Sequence[Step], offsets: Mapping[str, float]) -> str:
    """Times, the stick, and of each channel what was measured and what the filter expected before it saw the sample."""
    table = np.array([step.row for step in steps]).T
    expected = np.array([_expected(step) for step in steps]).T
    out: dict[str, Any] = {"t": _rounded(table[0], 9), "stick": _rounded(table[1])}
    for at, name in enumerate(OUTPUTS):
        out[name] = _rounded(FACTOR[name] * table[2 + at])
        out[f"{name}_expected"] = _rounded(FACTOR[name] * (expected[at] + offsets.get(name, 0.0)))
    return _line(out)


def estimates(time: float, items: Iterable[CrossValidation], weights: np.ndarray, kind: str) -> str:
    """The quantities as the terminal's table has them, and the likelihood of each delay; ``kind`` says whose estimate it is."""
    return _line({"t": round(time, 6), "kind": kind, "items": [_item(each) for each in items], "weights": _rounded(weights, 6)})


def status(state: str, sentence: str, numbers: Mapping[str, float]) -> str:
    """How the stream stands: ``state`` is waiting, collecting, running or ended."""
    return _line({"state": state, "sentence": sentence, **{name: _number(value) for name, value in numbers.items()}})


def _item(each: CrossValidation) -> dict[str, Any]:
    told = HANGING if each.hanging else f"{number_text(each.value, each.std)} ± {number_text(each.std, each.std)}"
    out: dict[str, Any] = {"name": each.name, "word": WORDS.get(each.name, each.name), "unit": "" if each.unit == "1" else each.unit, "told": told}
    out |= {} if each.hanging else {"value": _number(each.value), "std": _number(each.std)}
    if each.reference is not None:
        value, std = each.reference
        out |= {"reference": _number(value), "reference_std": _number(std), "reference_told": f"{number_text(value, std)} ± {number_text(std, std)}"}
        out |= {} if each.z is None else {"off": round(each.z, 2), "outside": each.beyond}
    return out


def _expected(step: Step) -> np.ndarray:
    """By the bank that was linearised anew, where there is one."""
    state = step.state if step.refined is None else step.refined.state
    return state.expected


def _rounded(values: np.ndarray, digits: int = 6) -> list[float | None]:
    """Significant digits enough for a page; None for what is missing."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
