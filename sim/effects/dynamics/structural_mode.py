"""One declared mode of a flexible aircraft, coupled to the rigid motion and to the other modes.

It belongs to the vehicle, whose data file gives the coefficients. The effect in `elastic_mode` is
for a mode that the declared model lacks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Effect, Parameter, Regularity, Signal, Station
from sim.errors import ModelError

_UNCOUPLED = 10  # number of parameters before those of the couplings between modes


@dataclass(frozen=True)
class StructuralMode:
    """Mode ``number`` of a flexible aircraft: eqs. 26-30 of the simulated-flight-data paper.

    CL += CL_eta eta + CL_etadot etadot c/(2V), Cm likewise, and eta_ddot = -2 zeta omega etadot -
    omega^2 eta + rho V^2 S c/(2 M) [Ceta_alpha alpha + Ceta_q q c/(2V) + Ceta_de elevator + sum_j
    (Ceta_etaJ eta_J + Ceta_etadotJ etadot_J c/(2V))], where alpha includes the gust.

    Full names of parameters contain the number of the mode: ``omega1`` (rad/s), ``zeta1``,
    ``generalized_mass1`` (kg m2), ``CL_eta1``, ``Ceta1_alpha``, ``Ceta1_eta2``. By default the
    frequency, the damping, and the couplings with the rigid motion are estimated. The others are
    held, ``Ceta1_de`` because it defines the scale of eta.

    Attributes
    ----------
    number : number of this mode, from 1.
    modes : numbers of the modes to which it is coupled, itself included. A mode that the model does
        not have adds nothing.
    """

    number: int = 1
    modes: tuple[int, ...] = (1,)

    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("lift", "moment")
    needs_constants: ClassVar[tuple[str, ...]] = ("chord", "airspeed")
    absent: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"CL_eta": 0.0, "CL_etadot": 0.0, "Cm_eta": 0.0, "Cm_etadot": 0.0}
    )
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    needs_priors: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "The structure is elastic. Each mode is an oscillator that the air drives and that changes "
        "the lift and the moment: eta_ddot = -2 zeta omega etadot - omega^2 eta + rho V^2 S c/(2 "
        "M) (Ceta_alpha alpha + Ceta_q q c/(2V) + Ceta_de elevator + ...), CL += CL_eta eta + "
        "CL_etadot etadot c/(2V), Cm likewise. In slow maneuvers the mode follows at once, and "
        "only the derivatives differ from those of the rigid aircraft. In fast maneuvers the "
        "record oscillates at the frequency of the mode. The scale of eta is a convention: "
        "doubling eta halves CL_eta and Cm_eta and doubles Ceta_alpha, Ceta_q and Ceta_de, so one "
        "of them must be held."
    )

    def __post_init__(self) -> None:
        if (
            self.number < 1
            or self.number not in self.modes
            or len(set(self.modes)) < len(self.modes)
        ):
            raise ModelError(
                f"mode {self.number} among the modes {self.modes}",
                where="elastic mode",
                remedy="number modes from 1, each once, its own included",
            )

    @property
    def name(self) -> str:
        return f"elastic-mode:{self.number}"

    @property
    def states(self) -> tuple[Signal, ...]:
        return (
            Signal(f"eta{self.number}", "1", f"generalized coordinate of mode {self.number}"),
            Signal(
                f"etadot{self.number}",
                "1/s",
                f"rate of the generalized coordinate of mode {self.number}",
            ),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, with starting values of a low bending mode of a large aircraft.

        Couplings between modes start at zero.
        """
        own = (
            Parameter("omega", 12.0, "rad/s", bounds=(0.5, 300.0)),
            Parameter("zeta", 0.02, "1", bounds=(0.0, 1.0)),
            Parameter("generalized_mass", 250.0, "kg m2", bounds=(1e-6, 1e12), free=False),
            Parameter("CL_eta", 0.03, "1"),
            Parameter("CL_etadot", 0.08, "1"),
            Parameter("Cm_eta", -0.03, "1"),
            Parameter("Cm_etadot", -0.16, "1"),
            Parameter("Ceta_alpha", -0.015, "1/rad"),
            Parameter("Ceta_q", -0.1, "1/rad"),
            Parameter("Ceta_de", -0.013, "1/rad", free=False),
        )
        couplings = [
            (
                Parameter(f"Ceta_eta{j}", 0.0, "1", free=False),
                Parameter(f"Ceta_etadot{j}", 0.0, "1", free=False),
            )
            for j in self.modes
        ]
        return own + tuple(item for pair in couplings for item in pair)

    def rename(self, local: str) -> str:
        """Return the full name of a parameter: ``CL_eta`` is ``CL_eta1``, ``Ceta_eta2`` is
        ``Ceta1_eta2``.
        """
        return (
            local.replace("Ceta_", f"Ceta{self.number}_")
            if local.startswith("Ceta_")
            else f"{local}{self.number}"
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        eta = getattr(s, f"eta{self.number}")
        etadot_hat = getattr(s, f"etadot{self.number}") * vehicle.chord / (2.0 * s.V)
        return {
            "lift": p.CL_eta * eta + p.CL_etadot * etadot_hat,
            "moment": p.Cm_eta * eta + p.Cm_etadot * etadot_hat,
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        eta, etadot = getattr(s, f"eta{self.number}"), getattr(s, f"etadot{self.number}")
        half_chord_time = vehicle.chord / (2.0 * s.V)
        force = p.Ceta_alpha * s.alpha_air + p.Ceta_q * s.q_hat + p.Ceta_de * s.elevator
        # Access by position takes a third of the time of access by name.
        couplings = p[_UNCOUPLED:]
        for (eta_j, etadot_j), by_eta, by_etadot in zip(
            _signals(self.modes), couplings[::2], couplings[1::2], strict=True
        ):
            force = force + by_eta * getattr(s, eta_j, 0.0)
            force = force + by_etadot * getattr(s, etadot_j, 0.0) * half_chord_time
        spring = -2.0 * p.zeta * p.omega * etadot - p.omega * p.omega * eta
        return etadot, spring + s.pressure_area * vehicle.chord / p.generalized_mass * force


@cache
def _signals(modes: tuple[int, ...]) -> tuple[tuple[str, str], ...]:
    return tuple((f"eta{j}", f"etadot{j}") for j in modes)


VARIANTS: tuple[Effect, ...] = (StructuralMode(),)
