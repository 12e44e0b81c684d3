"""Hand-made diagnoses for every verdict: what the loop would return, without the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.statistics.residuals import ErrorFigures, ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Caution,
    Claim,
    Concern,
    Diagnosis,
    FittedRecord,
    Prediction,
    Quantity,
    Step,
    Verdict,
)
from ident.tracing.result import not_noise
from scenarios.diagnosis.diagnose import Inputs, Tracing
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import VehicleFile
from scenarios.preparation.declared_model import model_of_file
from sim.record import Channel, Hold, Record

LEFT = "what is left lies in q, near 3.1 Hz, and follows the input"
NOISE = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012, "altitude": 6.0}
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g", "altitude": "m"}
RIGID = VehicleFile(
    "demonstrator",
    "rigid",
    {
        "mass": 7500.0,
        "wing_area": 30.1,
        "chord": 2.43,
        "pitch_inertia": 32000.0,
        "airspeed": 130.0,
        "air_density": 0.96,
    },
    {"CL_alpha": 5.1, "CL_q": 6.0, "CL_de": 0.42, "Cm_alpha": -0.92, "Cm_q": -17.0, "Cm_de": -1.35},
)
LOES = VehicleFile(
    "slow",
    "loes",
    {"airspeed": 208.0, "gravity": 9.8},
    {
        "L_alpha": -1.5,
        "M_alpha": -6.5,
        "L_delta": -0.003,
        "M_delta": 0.3,
        "L_q": 0.97,
        "M_q": -2.3,
        "inv_tau": 10.4,
        "delay": 0.07,
    },
)
BALLISTIC = VehicleFile(
    "capsule",
    "ballistic",
    {"air_density_reference": 1.225, "density_scale_height": 7160.0, "gravity": 9.79},
    {"beta": 423.6},
)

CLAIMS = {
    Verdict.CONSISTENT: (),
    Verdict.TRACED: (
        Claim(
            "input-deadband",
            {"half_width": Quantity(0.00698, 0.00017, "rad")},
            explanation="The linkage has free play.",
        ),
    ),
    Verdict.PARTIAL: (
        Claim(
            "sensor-lag:alpha",
            {"time_constant": Quantity(0.061, 0.002, "s")},
            ("sensor-delay:alpha", "vane-offset"),
        ),
        Claim("sensor-scale:nz", {"scale": Quantity(1.062, 0.003, "1")}),
    ),
    Verdict.AMBIGUOUS: (
        Claim("input-delay", {"delay": Quantity(0.061, 0.001, "s")}, ("actuator-lag",)),
    ),
    Verdict.UNEXPLAINED: (
        Claim(
            "gust-turbulence",
            {"sigma": Quantity(0.4, 0.2, "m/s"), "length": Quantity(200.0, 150.0, "m")},
            claimed=False,
        ),
    ),
}


def measured_record(
    channels: tuple[str, ...] = ("alpha", "q", "nz"),
    control: str = "elevator",
    count: int = 400,
    seed: int = 1,
) -> Record:
    """A 3-2-1-1 and an answer to it, with noise and a few missing samples of the first channel (two
    in a row, and the last).
    """
    rng = np.random.default_rng(seed)
    time = 0.02 * np.arange(count)
    shape = np.select(
        [(time > a) & (time <= b) for a, b in ((1, 2.5), (2.5, 3.5), (3.5, 4), (4, 4.5))],
        (1.0, -1.0, 1.0, -1.0),
        0.0,
    )
    size = {"elevator": -0.05, "stick": 1.0}.get(control, 0.0)
    outputs = []
    answer = np.convolve(shape, time[:150] * np.exp(-time[:150] / 0.25) * 0.32)[:count]
    # Lift and kinematics tie the channels: nz goes with alpha, q is alpha's rate and the path's.
    motion = {"alpha": 0.036 * answer, "nz": 0.36 * answer}
    motion["q"] = (
        np.gradient(motion["alpha"], time)
        + 9.8 / (208.0 if control == "stick" else 130.0) * motion["nz"]
    )
    motion["altitude"] = 30.0 * NOISE["altitude"] * answer + 50_000.0 - 900.0 * time
    for number, name in enumerate(channels):
        values = motion[name] + NOISE[name] * rng.standard_normal(count)
        if number == 0:
            values[[10, 11, count - 1]] = np.nan
        outputs.append(Channel.of(name, UNITS[name], values))
    inputs = (
        (Channel.of(control, "rad" if control == "elevator" else "in", size * shape),)
        if control
        else ()
    )
    return Record(
        time, inputs, tuple(outputs), Hold.PREVIOUS, "train.csv" if seed == 1 else "validate.csv"
    )


def tracing_of(
    verdict: Verdict,
    vehicle: VehicleFile = RIGID,
    *,
    channels: tuple[str, ...] = ("alpha", "q", "nz"),
    validations: int = 1,
    count: int = 400,
) -> Tracing:
    """A diagnosis with this verdict, and what it was made from."""
    model = model_of_file(vehicle)
    control = model.equations.inputs[0].name if model.equations.inputs else ""
    records = (measured_record(channels, control, count),)
    validation = tuple(
        measured_record(channels, control, count, seed) for seed in range(2, 2 + validations)
    )
    inputs = Inputs(
        tuple(InputFile(r.name, "0" * 64) for r in records),
        tuple(InputFile(r.name, "1" * 64) for r in validation),
        InputFile("v.toml", "2" * 64),
    )
    return Tracing(
        diagnosis_of(verdict, vehicle, records, validation),
        vehicle,
        model,
        records,
        validation,
        inputs,
    )


LATE = (0.058, 0.063, 0.060)
SAID = {"sensor-lag:alpha": 0.9, "sensor-delay:alpha": 0.07, "vane-offset": 0.03}


def each_record(
    values: tuple[float, ...] = LATE, name: str = "time_constant", unit: str = "s"
) -> tuple[Mapping[str, Quantity], ...]:
    """What each record by itself says of a parameter, to 0.004."""
    return tuple({name: Quantity(value, 0.004, unit)} for value in values)


def spread_tracing(tests: tuple[ResidualTest, ...] = ()) -> Tracing:
    """A late angle of attack beside a residual that is not noise: three records fitted, one held
    out.
    """
    tracing = tracing_of(Verdict.PARTIAL)
    derivatives = {name: {"Cm_q": Quantity(-17.0 - i, 0.4, "1/rad")} for i, name in enumerate(SAID)}
    claim = Claim(
        "sensor-lag:alpha",
        {"time_constant": Quantity(0.061, 0.002, "s")},
        ("sensor-delay:alpha", "vane-offset"),
        by_record=each_record(),
        derivatives_under=derivatives,
        probability=SAID,
        spread=5.2,
    )
    d = tracing.diagnosis
    moved = (
        {**d.before, "Cm_q": Quantity(-24.1, 0.9, "1/rad")},
        {**d.before, "Cm_q": Quantity(-17.2, 0.4, "1/rad")},
    )
    told = replace(
        d,
        effects=(claim,),
        before=moved[0],
        after=moved[1],
        scatter={"Cm_q": 0.83, "CL_q": 2.0},
        tests_after=tests or d.tests_after,
        warnings=tuple(not_noise(tests, 1e-4)),
    )
    three = tuple(replace(tracing.records[0], name=f"record_{number}.csv") for number in (1, 2, 3))
    return replace(tracing, diagnosis=told, records=three)


def diagnosis_of(
    verdict: Verdict,
    vehicle: VehicleFile,
    records: tuple[Record, ...],
    validation: tuple[Record, ...],
) -> Diagnosis:
    """A diagnosis with this verdict of given records."""
    model = model_of_file(vehicle)
    found = verdict is not Verdict.CONSISTENT
    free = [item for item in model.parameters if item.free]
    before = {item.name: Quantity(item.value, 0.03 * abs(item.value), item.unit) for item in free}
    after = {
        item.name: Quantity(item.value * (1.2 if found else 1.0), 0.01 * abs(item.value), item.unit)
        for item in free
    }
    derived = {
        "natural_frequency": Quantity(4.27, 0.05, "rad/s"),
        "damping_ratio": Quantity(0.41, 0.02, "1"),
    }
    derived |= {"delay": Quantity(0.09, 0.002, "s")} if vehicle.model == "loes" else {}
    derived = {} if vehicle.model == "ballistic" else derived
    factor = 4.0 if found else 1.0
    names = records[0].output_names
    claims = CLAIMS[verdict]
    return Diagnosis(
        verdict,
        claims,
        before,
        after,
        derived,
        derived,
        _figures(names, factor),
        _figures(names, 1.02),
        {name: NOISE[name] for name in names},
        True,
        _tests(names, 1e-12 if found else 0.3),
        _tests(
            names,
            0.2 if verdict in (Verdict.TRACED, Verdict.CONSISTENT, Verdict.AMBIGUOUS) else 1e-9,
        ),
        tuple(
            Step(
                tuple(c.name for c in claims[: i + 1]),
                100.0 - i,
                -50.0,
                "white noise, effects added to the declared model: most probable so far is "
                f"{claim.name}, log posterior odds +120.0",
            )
            for i, claim in enumerate(claims)
        ),
        _candidates(claims),
        (Caution(Concern.NOT_NOISE, LEFT),)
        if verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)
        else (),
        tuple(_prediction(record, factor) for record in validation),
        tuple(_fitted(record, factor) for record in records),
        residual_std={name: NOISE[name] for name in names},
    )


def _figures(names: tuple[str, ...], factor: float) -> ErrorFigures:
    def each(value: float) -> Mapping[str, float]:
        return dict.fromkeys(names, value)

    return ErrorFigures(
        {name: factor * NOISE[name] for name in names},
        each(0.03 * factor),
        each(1.0 - 0.001 * factor**2),
        each(0.02 * factor),
    )


def _tests(names: tuple[str, ...], p_value: float) -> tuple[ResidualTest, ...]:
    return tuple(
        ResidualTest(
            "ljung-box",
            name,
            31.0,
            p_value,
            "white over 25 lags" if p_value > 1e-3 else "not white over 25 lags",
        )
        for name in names
    )


def _candidates(claims: tuple[Claim, ...]) -> tuple[Candidate, ...]:
    others = (
        Candidate(
            1, (), "sensor-scale:alpha", 3.1, -2.0, True, {"scale": Quantity(1.01, 0.004, "1")}
        ),
        Candidate(1, (), "vane-offset", 1.4, -3.7, False, {}, ("sensor-lag:alpha",)),
        Candidate(1, (), "speed-variation", -2.5, -7.6, False, {}),
    )
    best = tuple(
        Candidate(
            i + 1,
            tuple(c.name for c in claims[:i]),
            claim.name,
            420.0 / (i + 1),
            420.0 / (i + 1) - 5.1,
            True,
            claim.parameters,
            claim.alternatives,
        )
        for i, claim in enumerate(claims)
    )
    return best + others


def _fitted(record: Record, factor: float) -> FittedRecord:
    z, valid = record.output_array()
    rng = np.random.default_rng(5)
    noise = np.array([NOISE[name] for name in record.output_names])[:, None]
    after = np.where(valid, noise * rng.standard_normal(z.shape), 0.0)
    before = after + np.where(valid, (factor - 1.0) * noise * np.sin(6.0 * record.time), 0.0)
    used = valid.copy()
    spike = min(50, len(record) - 5)
    used[0, spike] = False
    after[0, spike] = before[0, spike] = 9.0 * noise[0, 0]
    return FittedRecord(record, record.output_names, before, after, used)


def _prediction(record: Record, factor: float) -> Prediction:
    z, _ = record.output_array()
    smooth = np.array([np.convolve(row, np.ones(9) / 9.0, mode="same") for row in z])
    noise = np.array([NOISE[name] for name in record.output_names])[:, None]
    return Prediction(
        record,
        record.output_names,
        smooth + (factor - 1.0) * noise * np.sin(3.0 * record.time),
        smooth,
    )


def written_inputs(folder: Path, count: int = 200) -> tuple[Path, Path, Path]:
    """Record, record for validation and vehicle file of the rigid aircraft, on disk."""
    from scenarios.files.writing import write_record

    for stem, seed in (("train", 1), ("validate", 2)):
        write_record(folder, measured_record(count=count, seed=seed), stem)
        (folder / f"{stem}.json").unlink()
    vehicle = folder / "vehicle.toml"
    lines = [f"{key} = {value}" for key, value in RIGID.constants.items()]
    lines += ["[derivatives]", *(f"{key} = {value}" for key, value in RIGID.derivatives.items())]
    vehicle.write_text("\n".join(['name = "demonstrator"', *lines]), encoding="utf-8")
    return folder / "train.csv", folder / "validate.csv", vehicle
