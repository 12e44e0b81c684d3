"""How long the models of whole axes take: a fit by output error, and diagnoses with every effect
offered.

    python benchmarks/any_axis.py [--runs N]

Two records of 2001 samples, one fitted and one held out, of an aircraft with 4 states and 5
(lateral) or 6 (longitudinal) outputs, all derivatives and biases free. The ratio of a fit is to
that of the short period on as many samples in the same run; that of a diagnosis is to the lateral
record with nothing missing.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
CONSISTENT = 'distance="nothing missing"'
RATE = ('flight.rate="100 Hz"',)
LIMIT = 15.0  # wall seconds asked for on two cores
KINDS = {
    "lateral, nothing": ("trace-lateral-rudder", ("hidden=[]", CONSISTENT)),
    "lateral, rudder late": ("trace-lateral-rudder", ()),
    "lateral, backlash": ("trace-lateral-backlash", ()),
    "lateral, side gust": ("trace-lateral-gust", ()),
    "longitudinal, thrust": ("trace-longitudinal-thrust", ()),
    "longitudinal, drag": ("trace-longitudinal-drag", ()),
}  # scenario and changes


FITS = {
    "rigid": "trace-nothing",
    "lateral": "trace-lateral-rudder",
    "longitudinal": "trace-longitudinal-thrust",
}
FIT_LIMIT = 1.0  # s of computing, asked for the lateral model: 20 parameters, 4 states, 5 outputs


def fit_seconds(scenario: str, folder: Path, runs: int) -> tuple[float, int]:
    """Median processor seconds of a fit by output error from a start 30 % off, and the number of
    its parameters; record without the hidden effect.
    """
    from benchmarks.diagnose import fly
    from ident.whole_record.output_error import fit_output_error
    from scenarios.files.records import read_record
    from scenarios.files.vehicles import read_any_vehicle
    from scenarios.preparation.declared_model import model_of_file
    from sim.declaration.compile import compile_model

    train, _, vehicle = fly(scenario, folder, (*RATE, "hidden=[]", CONSISTENT))
    model = model_of_file(read_any_vehicle(vehicle))
    inputs, outputs = (
        [signal.name for signal in group]
        for group in (model.equations.inputs, model.equations.outputs)
    )
    record = read_record(train[0], inputs, outputs)
    begins = {
        channel.name: float(channel.values[0])
        for channel in record.outputs
        if channel.name in ("airspeed", "alpha", "theta")
    }
    begun = (
        model
        if model.equations.name != "longitudinal"
        else model.with_initial(model.initial.with_values(begins))
    )
    system = compile_model(begun.with_biases(outputs))
    seconds = []
    for _ in range(runs):
        begin = time.process_time()
        estimate = fit_output_error([record], system)
        seconds.append(time.process_time() - begin)
    return statistics.median(seconds), len(estimate.names)


def main() -> None:
    from benchmarks.diagnose import diagnosed, fly, line

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    runs = parser.parse_args().runs
    reference = 0.0
    with tempfile.TemporaryDirectory() as temporary:
        for model, scenario in FITS.items():
            seconds, number = fit_seconds(scenario, Path(temporary) / f"fit-{model}", runs)
            reference = reference or seconds
            print(
                f"{model:12} fit of {number} shared parameters: processor {seconds:.2f} s (asked "
                f"{FIT_LIMIT:g}), {seconds / reference:.1f} x rigid",
                flush=True,
            )
        reference = 0.0
        for words, (scenario, changes) in KINDS.items():
            folder = Path(temporary) / words.replace(", ", "-").replace(" ", "-")
            wall, processor, steps = diagnosed(
                fly(scenario, folder, (*RATE, *changes)), folder, runs, words.split(",")[0]
            )
            reference = reference or wall
            print(line(f"{words:21}", LIMIT, wall, processor, reference, steps), flush=True)


if __name__ == "__main__":
    main()
