"""Simulate flights of one aircraft for `flightid survey`: a vane on a nose boom in all, a late gyro
channel in every second one.

    python docs/how-to/fleet.py flights --count 40

writes records, ``aircraft.toml``, ``flights.toml`` and, for whoever compares afterwards,
``truth.json``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.effect import full_name
from sim.declaration.model import Noise
from sim.effects.library import effects_for
from sim.maneuvers import Sum, doublet, three_two_one_one
from sim.truth.flight import fly, sample_times

AIRCRAFT = """\
name = "jet trainer"
mass = 5000.0            # kg
wing_area = 17.0         # m2
chord = 2.1              # m
pitch_inertia = 18000.0  # kg m2
airspeed = 130.0         # m/s
air_density = 1.0        # kg/m3

[derivatives]
CL_alpha = {CL_alpha}
CL_q = {CL_q}
CL_de = {CL_de}
Cm_alpha = {Cm_alpha}
Cm_q = {Cm_q}
Cm_de = {Cm_de}
"""
TRUE = {"CL_alpha": 5.0, "CL_q": 4.0, "CL_de": 0.4, "Cm_alpha": -0.6, "Cm_q": -12.0, "Cm_de": -1.2}
# what the file declares
STARTS = {
    "CL_alpha": 4.2,
    "CL_q": 5.0,
    "CL_de": 0.5,
    "Cm_alpha": -0.5,
    "Cm_q": -14.0,
    "Cm_de": -1.0,
}
NOISE = {"alpha": np.radians(0.1), "q": np.radians(0.15), "nz": 0.015}
RATE = 40.0  # Hz
BOOM, LATE = 3.0, 0.06  # m, s
DRIFT = 0.05  # of Cm_alpha for each thousand kg above 5000


def simulate_fleet(
    folder: str | Path,
    count: int = 40,
    *,
    seed: int = 1,
    boom: float = BOOM,
    late: float = LATE,
    first: int = 1,
    every: int = 2,
) -> list[Path]:
    """Fly ``count`` flights from number ``first`` on at other airspeeds and masses; zero for
    ``boom`` (m) or ``late`` (s) leaves it out.

    The same number is the same flight, whatever ``count`` is. The records' paths.
    """
    folder = Path(folder)
    (folder / "records").mkdir(parents=True, exist_ok=True)
    (folder / "aircraft.toml").write_text(AIRCRAFT.format(**STARTS), encoding="utf-8")
    (folder / "true.toml").write_text(AIRCRAFT.format(**TRUE), encoding="utf-8")
    vehicle = model_of_file(read_vehicle(folder / "true.toml", "rigid"))
    known = {effect.name: effect for effect in effects_for(vehicle.equations)}
    written, entries, truth = [], [], {}
    for number in range(first, first + count):
        rng = np.random.default_rng([seed, number])
        condition = {
            "airspeed": round(rng.uniform(90.0, 180.0), 1),
            "mass": round(rng.uniform(4400.0, 5600.0), 0),
        }
        moment = TRUE["Cm_alpha"] * (1.0 + DRIFT * (condition["mass"] - 5000.0) / 1000.0)
        hidden = {"vane-offset": ("arm", boom)} if boom else {}
        hidden |= {"sensor-delay:q": ("delay", late)} if late and number % every == 0 else {}
        # some flights are noisier than others, and tell less by themselves
        rough = rng.uniform(1.0, 4.0)
        noise = {name: rough * std for name, std in NOISE.items()}
        model = vehicle.with_values({**condition, "Cm_alpha": moment}).with_noise(Noise(noise))
        for name, (local, value) in hidden.items():
            model = model.with_effects(known[name]).with_values(
                {full_name(known[name], local): value}
            )
        maneuver = Sum(
            (
                three_two_one_one(
                    np.radians(rng.uniform(1.0, 2.0)), _on_samples(rng.uniform(0.35, 0.55)), 1.0
                ),
                doublet(
                    np.radians(-rng.uniform(0.8, 1.6)), _on_samples(rng.uniform(0.5, 0.8)), 8.0
                ),
                doublet(
                    np.radians(rng.uniform(0.8, 1.6)), _on_samples(rng.uniform(0.3, 0.5)), 13.0
                ),
            )
        )
        name = f"flight{number:03d}"
        record, _ = fly(
            model,
            maneuver,
            sample_times(RATE, 18.0),
            rng,
            step=0.005,
            outputs=list(NOISE),
            name=name,
        )
        written.append(write_record(folder / "records", record, name, simulated=True)[0])
        entries.append(
            f'[[flights]]\nrecord = "records/{name}.csv"\nvehicle = {{mass = {condition["mass"]}, '
            f"airspeed = {condition['airspeed']}}}\n"
        )
        truth[name] = {
            **condition,
            "Cm_alpha": moment,
            **{f"{effect}.{local}": value for effect, (local, value) in hidden.items()},
        }
    head = 'title = "simulated fleet"\nmodel = "rigid"\nvehicle = "aircraft.toml"\n\n'
    (folder / "flights.toml").write_text(head + "\n".join(entries), encoding="utf-8")
    (folder / "true.toml").unlink()
    (folder / "truth.json").write_text(
        json.dumps({"derivatives": TRUE, "flights": truth}, indent=1), encoding="utf-8"
    )
    return written


def _on_samples(seconds: float) -> float:
    """The nearest whole number of samples: a record holds its inputs from one sample to the
    next.
    """
    return round(seconds * RATE) / RATE


def main(given: Sequence[str] | None = None) -> None:
    """Read the command line and simulate."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=40, help="how many flights")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--boom", type=float, default=BOOM, help="arm of the vane, m; 0: none")
    parser.add_argument(
        "--late", type=float, default=LATE, help="delay of q in every second flight, s; 0: none"
    )
    asked = parser.parse_args(given)
    simulate_fleet(asked.folder, asked.count, seed=asked.seed, boom=asked.boom, late=asked.late)
    print(f"{asked.count} flights in {asked.folder}")


if __name__ == "__main__":
    main()
