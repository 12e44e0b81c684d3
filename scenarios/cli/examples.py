"""Examples of every command, as the help shows them and a test runs them, one after the other in an empty folder."""

from __future__ import annotations

from collections.abc import Mapping

# What is typed, and what it does. The order is that in which they run: later ones take files that earlier ones wrote.
EXAMPLES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "list": (
        ("flightid list", "what there is to run"),
        ("flightid list rigid > mine.toml", "the file of a scenario, to copy and edit"),
    ),
    "run": (
        ("flightid run rigid --out study", "simulate, identify, compare with the truth, into a folder"),
        ("flightid run mine.toml --seed 3 --set flight.rate=50 --out edited", "an edited copy, with another seed and sampling"),
    ),
    "compare": (("flightid compare study edited", "studies side by side, from their folders"),),
    "simulate": (
        ("flightid simulate rigid --seed 3 --out rigid.csv", "a record as a flight test would hand it over"),
        ("flightid simulate trace-vane --out flight.csv", "two records with something hidden in them, and a vehicle file"),
    ),
    "campaign": (
        ("flightid campaign rigid --runs 100", "bias, scatter and coverage over a hundred seeds"),
        ("flightid campaign ballistic --runs 20 --out campaign", "the same into a folder, with figures and every run"),
    ),
    "map": (
        ("flightid map flight.csv", "the content of a recorder's file, and drafts of its channel map and vehicle file"),
        ("flightid map flight.csv --out draft", "the drafts as files, to check and complete"),
    ),
    "maneuvers": (
        ("flightid maneuvers flight.csv", "steps, doublets, sweeps, turns and the like in a long record"),
        ("flightid maneuvers flight.csv --out found", "with the flight in a figure and maneuvers.toml for --maneuver"),
    ),
    "response": (
        ("flightid response flight.csv --input elevator --output q --out bode", "the response of the pitch rate to the elevator"),
        ("flightid response flight.csv --input elevator --output q --output alpha --band 0.2 2", "two outputs, in a band in Hz"),
    ),
    "identify": (
        ("flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --out fit", "parameters of a model from a record"),
        (
            "flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --validate flight_validate.csv --from 1 --to 9",
            "from a part of it, and what that predicts of another",
        ),
        ("flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --json > fit.json", "for a program that reads on"),
    ),
    "diagnose": (
        (
            "flightid diagnose flight.csv --model rigid --vehicle flight_vehicle.toml --validate flight_validate.csv --out cause",
            "what the model lacks, and the error before and after on another record",
        ),
    ),
    "design": (
        ("flightid design --model rigid --vehicle flight_vehicle.toml --out plan", "the maneuver that determines the derivatives best"),
        (
            "flightid design --model rigid --vehicle flight_vehicle.toml --tell vane-offset,sensor-lag:alpha --size 'arm=2 m'",
            "the one that tells a vane ahead of the centre of gravity from a slow one",
        ),
    ),
    "predict": (
        ("flightid predict fit flight_validate.csv", "the model of a study on a record that it has not seen"),
        ("flightid predict cause flight_validate.csv --out prediction", "with the effects that were claimed, into a folder"),
    ),
    "report": (("flightid report study edited", "the pages of study folders again, with nothing computed"),),
    "check": (("flightid check flight.csv --vehicle flight_vehicle.toml", "what the kinematics alone say of the sensors"),),
    "survey": (
        ("flightid survey --example > flights.toml", "the file of a survey, to copy and edit"),
        ("flightid survey flights.toml --out morning", "each flight diagnosed and kept, then what recurs; again after each new flight"),
    ),
    "watch": (
        ("flightid simulate x29-simulation --out stream.csv", "a record of the closed loop, which stands for a stream"),
        ("flightid watch stream.csv --model loes --until-end --no-refine", "identified row by row"),
    ),
    "models": (
        ("flightid models", "the models that there are"),
        ("flightid models --example > my_model.py", "the file of a model of one's own, to copy and edit"),
        ("flightid models my_model.py", "what it declares, checked"),
    ),
    "vehicles": (
        ("flightid vehicles bomber_rigid", "every number with unit and origin"),
        ("flightid vehicles bomber_ac2 --diff bomber_ac1", "what differs from another vehicle"),
    ),
    "lab": (("flightid lab", "the labs that there are"), ("flightid lab 1 --key", "the instructor's key of one")),
    "effects": (("flightid effects vane-offset", "one effect, explained"),),
}


def examples_text(command: str) -> str:
    """The examples of a command as its help ends with them; empty where there are none."""
    lines = [line for typed, does in EXAMPLES.get(command, ()) for line in (f"  {typed}", f"      {does}")]
    return "\n".join(["Examples:", *lines]) if lines else ""
