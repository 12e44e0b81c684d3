"""Laws of what every effect tells a search. A new effect is covered as soon as its file is
there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.effect import NoiseEffect, Regularity, full_name
from sim.declaration.proposal import FittedToRecord, Refinable, SearchContext, Traceable, fitted_to
from sim.effects.library import catch_all_terms_for, library
from tests.bases import base_for, fly
from tests.offered import (
    VEHICLES,
    first_of_each_kind,
    guards_of_whole_axes,
    held_to_all_laws,
    representatives,
)

CONTEXTS = {
    "usual": SearchContext(
        0.0,
        20.0,
        0.02,
        input_peak={
            "elevator": 0.08,
            "stick": 1.2,
            "aileron": 0.1,
            "rudder": 0.1,
            "thrust": 2000.0,
        },
        input_rate={"elevator": 4.0, "stick": 60.0, "aileron": 5.0, "rudder": 5.0, "thrust": 3e4},
        state_peak={
            "alpha": 0.1,
            "q": 0.2,
            "nz": 1.1,
            "altitude": 6e4,
            "beta": 0.1,
            "p": 0.4,
            "r": 0.3,
            "ny": 0.2,
            "airspeed": 55.0,
        },
        flown={"alpha": (-0.04, 0.1), "velocity": (-1800.0, -300.0)},
        residual_peaks=(14.0, 3.1),
        airspeed=150.0,
    ),
    "slow and late": SearchContext(
        100.0, 106.0, 0.1, input_peak={"elevator": 0.01, "stick": 0.1}, airspeed=80.0
    ),
    "nothing known": SearchContext(0.0, 5.0, 0.01),
}
# A tracked fall alone cannot show these: they equal another start or another ballistic coefficient.
INVISIBLE = {"sensor-delay:altitude", "sensor-lag:altitude"}
FLOWN = {
    "loes": {"alpha": (-0.03, 0.03)},
    "lateral": {"beta": (-0.12, 0.1)},
    "longitudinal": {"alpha": (-0.06, 0.09)},
}
# of an output's peak: far above what the order of a batch does to it, far below a millionth of an
# effect
ROUNDING = 1e-12
every_context = pytest.mark.parametrize("context", CONTEXTS.values(), ids=CONTEXTS)
OFFERED = [
    (effect, vehicle.name)
    for vehicle in VEHICLES
    for effect in (*held_to_all_laws(vehicle), *catch_all_terms_for(vehicle))
]
OFFERED += representatives() + first_of_each_kind(guards_of_whole_axes())
CASES = [
    pytest.param(effect, base, id=f"{effect.name} on {base}")
    for effect, base in OFFERED
    if isinstance(effect, Traceable)
]
every_case = pytest.mark.parametrize(("effect", "base"), CASES)
# Where a signature has been seen on one vehicle, that on another is for the slow suite.
_FIRST = {effect.name: base for effect, base in reversed(OFFERED)}
FLOWN_CASES = [
    pytest.param(
        effect,
        base,
        id=f"{effect.name} on {base}",
        marks=[] if _FIRST[effect.name] == base else [pytest.mark.slow],
    )
    for effect, base in OFFERED
    if isinstance(effect, Traceable)
]


def forms(effect: Traceable, context: SearchContext) -> list[Traceable]:
    """The form for a search context, and the finer one where there is one."""
    form = fitted_to(effect, context)
    return [form, form.finer()] if isinstance(form, Refinable) else [form]


def test_all_effects_but_the_modes_that_a_vehicle_declares_can_be_proposed() -> None:
    assert {effect.name for effect in library() if not isinstance(effect, Traceable)} == {
        "elastic-mode:1"
    }


@every_case
@every_context
def test_probes_are_complete_and_within_the_bounds(
    effect: Traceable, base: str, context: SearchContext
) -> None:
    for form in forms(effect, context):
        assert isinstance(form, Traceable)
        assert form.name == effect.name and isinstance(form, FittedToRecord) == isinstance(
            effect, FittedToRecord
        )
        items = {item.name: item for item in form.parameters}
        assert set(form.traits.plausible) <= set(items)
        for name, (low, high) in form.traits.plausible.items():
            assert low < high and items[name].bounds[0] <= low and high <= items[name].bounds[1]
        assert not form.traits.onset or form.traits.onset in items
        if form.regularity in (Regularity.CHANGE_POINT, Regularity.OUTLIER):
            assert form.traits.per_record
        probes = form.probes(context)
        if context is CONTEXTS["usual"] and form.regularity is not Regularity.OUTLIER:
            assert bool(probes) == (form.name not in INVISIBLE)
        for probe in probes:
            assert set(probe.values) == set(items) and set(probe.slopes) <= {
                name for name, item in items.items() if item.free
            }
            for name, value in probe.values.items():
                assert items[name].bounds[0] <= value <= items[name].bounds[1]
            differs = any(probe.values[name] != value for name, value in form.absent.items())
            assert differs or probe.slopes, "a whole change from absence to absence is none"
            assert not probe.shifts or form.traits.onset
            if form.traits.onset:
                assert context.begin <= probe.values[form.traits.onset] < context.end


@pytest.mark.sampled
@pytest.mark.parametrize(("effect", "base"), FLOWN_CASES)
def test_each_signature_is_there(effect: Traceable, base: str) -> None:
    if isinstance(effect, NoiseEffect) or effect.regularity is Regularity.OUTLIER:
        return
    model, flight = base_for(base)
    span = float(flight.time[-1] - flight.time[0])
    peaks = {
        signal.name: float(np.max(np.abs(row)))
        for signal, row in zip(model.equations.inputs, flight.u, strict=True)
    }
    rates = {name: 2.0 * peak / 0.02 for name, peak in peaks.items()}
    flown = FLOWN.get(base, {"alpha": (-0.1, 0.15), "velocity": (-1900.0, -900.0)})
    context = SearchContext(
        0.0,
        span,
        span / (flight.time.size - 1),
        input_peak=peaks,
        input_rate=rates,
        flown=flown,
        airspeed=200.0,
    )
    form = fitted_to(effect, context)
    assert isinstance(form, Traceable)
    system = compile_model(model.with_effects(form))
    start = system.parameters.values()
    names = {
        item.name: system.parameters.index(full_name(form, item.name)) for item in form.parameters
    }
    gone = start.copy()
    for name, value in form.absent.items():
        gone[names[name]] = value
    # of points by their positions: what differs, and the slope it is for
    points, changes = [gone], []
    probes = form.probes(context)
    for probe in probes[:: max(1, len(probes) // 4)]:
        p = start.copy()
        for name, value in probe.values.items():
            p[names[name]] = value
        points.append(p)
        here = len(points) - 1
        if not probe.slopes:
            changes.append((0, here, ""))
        for slope in probe.slopes:
            moved = p.copy()
            moved[names[slope]] += 1e-6 * max(1.0, abs(p[names[slope]]))
            points.append(moved)
            changes.append((here, len(points) - 1, slope))
    # All at once: a batch is one by one (test_effect_laws.py), but for rounding, which is no
    # signature.
    rows = fly(
        system,
        flight,
        [float(row[0]) if np.all(row == row[0]) else row for row in np.array(points).T],
    )
    outputs = [
        row if np.ndim(row) == 2 else np.repeat(np.asarray(row)[:, None], len(points), axis=1)
        for row in rows
    ]
    largest: dict[str, float] = {}
    for before, after, slope in changes:
        change = max(
            float(np.max(np.abs(row[:, after] - row[:, before])) / np.max(np.abs(row)))
            for row in outputs
        )
        largest[slope] = max(largest.get(slope, 0.0), change)
    assert all(change > ROUNDING for change in largest.values()), largest


@pytest.mark.sampled
@every_case
def test_the_finer_form_with_no_more_is_the_usual_one(effect: Traceable, base: str) -> None:
    if not isinstance(effect, Refinable):
        return
    model, flight = base_for(base)
    finer = effect.finer()
    usual = [item.name for item in effect.parameters]
    assert set(usual) < {item.name for item in finer.parameters}
    given = {item.name: item.value for item in effect.parameters}
    more = {item.name: 0.0 for item in finer.parameters if item.name not in given}
    assert all(finer.absent.get(name, 0.0) == 0.0 for name in more)
    expected = fly(compile_model(model.with_effects(effect)), flight)
    present = model.with_effects(finer).with_values(
        {full_name(finer, name): value for name, value in {**given, **more}.items()}
    )
    for got, wanted in zip(fly(compile_model(present), flight), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-11 * np.max(np.abs(wanted)))


def test_a_context_falls_back_on_peaks_and_spreads_its_onsets() -> None:
    context = CONTEXTS["usual"]
    assert context.flown_range("alpha") == (-0.04, 0.1)
    assert context.flown_range("q") == (-0.2, 0.2) and context.flown_range("elevator") == (
        -0.08,
        0.08,
    )
    assert context.flown_range("theta") is None
    onsets = replace(context, begin=3.0).onsets()
    assert len(onsets) == 36 and onsets[0] > 3.0 and onsets[-1] < 20.0
    np.testing.assert_allclose(np.diff(onsets), 17.0 / 36)
