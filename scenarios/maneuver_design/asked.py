"""What a design is asked, in the words of its command line, which do it again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenarios.files.sources import Source
from scenarios.files.user_models import OwnModel

TYPICAL, JUST_FOUND = "typical", "found"


@dataclass(frozen=True, eq=False)
class Asked:
    """What is asked. Texts are as they are typed, ``NAME=VALUE``, values with a unit where they have another than SI.

    Attributes
    ----------
    model, vehicle : as of ``identify``. limits : a TOML file, or its content.
    tell : names of effects to be told apart, the first against each other one.
    size : ``typical``, ``found`` (just found in the reference maneuver), or ``KEY=VALUE,...`` of the first effect's own parameters.
    values : derivatives that are better known than from the vehicle file. noise, amplitude : by output, by input.
    duration, rate : s and samples a second; None: as the model's roots, or the band, ask for.
    band : Hz; sweeps and multisines over it, compared by the frequency responses that they give.
    """

    model: str | OwnModel
    vehicle: Path | Source | None = None
    limits: Path | Mapping[str, Any] | None = None
    tell: tuple[str, ...] = ()
    size: str = TYPICAL
    values: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    amplitude: tuple[str, ...] = ()
    duration: float | None = None
    rate: float | None = None
    band: tuple[float, float] | None = None
    command_names: Mapping[str, str] = field(default_factory=dict)

    def command(self) -> str:
        """What is typed for it."""
        words = ["flightid", "design", "--model", self.command_names.get("model", str(self.model))]
        vehicle = self.command_names.get("vehicle", str(self.vehicle) if isinstance(self.vehicle, Path) else "")
        words += ["--vehicle", vehicle] if vehicle else []
        words += ["--limits", str(self.limits)] if isinstance(self.limits, Path) else []
        words += ["--tell", ",".join(self.tell)] if self.tell else []
        words += ["--size", self.size] if self.tell and self.size != TYPICAL else []
        for option, texts in (("--value", self.values), ("--noise", self.noise), ("--amplitude", self.amplitude)):
            words += [option, ",".join(texts)] if texts else []
        words += ["--duration", f"{self.duration:g}"] if self.duration is not None else []
        words += ["--rate", f"{self.rate:g}"] if self.rate is not None else []
        words += ["--band", *(f"{each:g}" for each in self.band)] if self.band is not None else []
        return shlex.join(words)
