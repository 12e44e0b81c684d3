"""What an estimate leaves for the prediction of other records."""

from __future__ import annotations

from collections.abc import Mapping

from ident.tracing.diagnosis import Trained
from ident.whole_record.layout import FitSettings
from sim.declaration.model import System


def trained_by(system: System, values: Mapping[str, float], settings: FitSettings) -> Trained:
    """What a free simulation of another record takes from an estimate: ``values`` where they are given, else what the system holds."""
    known = {item.name: float(values.get(item.name, item.value)) for item in system.parameters}
    biases = {name: value for name, value in known.items() if name.startswith("bias_")}
    shared = {name: value for name, value in known.items() if name not in biases}
    return Trained((), system.output_names, shared, (biases,), settings)
