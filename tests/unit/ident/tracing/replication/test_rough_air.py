"""Rough air that is rougher than its model, and what only looks like it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.belief.evenness import is_even
from ident.tracing.belief.standing import why_not
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Caution, Concern
from ident.tracing.loop import fit_declared, held_out_data
from ident.tracing.replication import rough_air
from ident.tracing.replication.rough_air import predicted, process_noise_that_stands
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.validation.held_out import HeldOutData
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.maneuvers.steps import doublet, sequence, three_two_one_one
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.truth.noise import coloured_noise
from tests.bases import rigid_model
from tests.tracing_problem import coloured, planted, problem_of, with_output

ROUGH = GustTurbulence()
VALUES = {"gust-turbulence.sigma": 1.5, "gust-turbulence.length": 250.0}
GYRO = 0.002  # rad/s, of the pitch rate that follows other, faster gusts


def rough(seed: int) -> Record:
    """Rough air, and a pitch rate that follows other gusts, of which the model knows nothing."""
    rng = np.random.default_rng((seed, 3))
    model = rigid_model().with_effects(ROUGH).with_values(VALUES)
    maneuver = sequence([three_two_one_one(0.06, 0.5), doublet(0.03, 1.0), doublet(0.06, 0.5)], 2.0, start=1.0)
    record, _ = fly(model, maneuver, sample_times(20.0, 50.0), rng, step=0.02)
    faster = coloured_noise(rng, record.time, GYRO, 0.15)
    return with_output(record, "q", record["q"].values + faster)


def begun(records: Sequence[Record]) -> tuple[Ledger, FittedModel, HeldOutData]:
    done = fit_declared(problem_of(records[:2], [ROUGH]))
    return done.ledger, done.root, held_out_data(done, records[2:])


def test_rough_air_stands_although_what_it_leaves_is_not_white() -> None:
    ledger, root, held = begun([rough(seed) for seed in (1, 2, 3)])
    after, found = process_noise_that_stands(ledger, root, held)
    assert found is not None and found.fitted.names == (ROUGH.name,)
    fitted = found.fitted
    assert fitted.values.shared["gust-turbulence.sigma"] == pytest.approx(1.5, rel=0.5)
    assert "one-step predictions on records not fitted" in after.steps[-1].sentence
    assert after.evidence[-1].remark.startswith("one-step predictions bring")
    gain = predicted(fitted, held.declared.frozen)  # type: ignore[arg-type]
    assert gain.share > thresholds.SHARE_OF_ANY_COLOUR and gain.by_process_noise > 100.0
    assert found.gains == (gain.by_process_noise,)


def test_rough_air_beside_a_phugoid_that_no_one_believes_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside any other it stands; of one that has taken in what is missing the numbers are beyond belief."""
    done = fit_declared(problem_of([rough(seed) for seed in (1, 2)], [ROUGH, Phugoid()]))
    ledger, base = fit(done.ledger, (Phugoid(),), done.root)
    assert base is not None
    held = held_out_data(done, [rough(3)])
    _, found = process_noise_that_stands(ledger, base, held)
    assert found is not None and found.fitted.names == ("phugoid", ROUGH.name)
    denied = Caution(Concern.BEYOND_BELIEF, "no one believes it")
    monkeypatch.setattr(rough_air, "why_not", lambda effect, *more: denied if effect.name == "phugoid" else why_not(effect, *more))
    assert process_noise_that_stands(ledger, base, held)[1] is None


def test_colour_of_each_channel_by_itself_is_no_rough_air() -> None:
    ledger, root, held = begun([coloured(planted([], None, seed), seed) for seed in (4, 5, 6)])
    after, fitted = process_noise_that_stands(ledger, root, held)
    assert fitted is None and after.models == ledger.models


def test_what_is_left_where_the_aircraft_moves_is_no_rough_air() -> None:
    """A strong curve of the moment: process noise would take it in, and it is there only where the angle of attack is large."""
    names = [f"moment-nonlinearity.{item.name}" for item in MOMENT_NONLINEARITY.parameters]
    values = {name: 0.4 * (-1.0) ** i for i, name in enumerate(names)}
    ledger, root, held = begun([planted([MOMENT_NONLINEARITY], values, seed) for seed in (1, 2, 3)])
    assert not is_even([root.fit])
    assert process_noise_that_stands(ledger, root, held) == (ledger, None)


def test_the_same_level_throughout_is_even() -> None:
    _, root, _ = begun([planted([], None, seed) for seed in (1, 2, 3)])
    assert is_even([root.fit])


def test_what_cannot_be_asked_is_not_said() -> None:
    ledger, root, held = begun([rough(seed) for seed in (1, 2, 3)])
    assert process_noise_that_stands(ledger, root, HeldOutData()) == (ledger, None)
    moved = ledger.problem.fit((ROUGH,), root, None, rough=True)
    assert moved is not None and process_noise_that_stands(ledger, moved, held) == (ledger, None)


@pytest.mark.parametrize(("scatter", "stands"), [(0.01, False), (0.06, True)])
def test_a_simulation_that_chance_makes_worse_is_held_against_no_turbulence(monkeypatch: pytest.MonkeyPatch, scatter: float, stands: bool) -> None:
    """Derivatives of a fit in rough air differ from those without, and the gusts of one more record may favour the wrong ones."""
    ledger, root, held = begun([rough(seed) for seed in (1, 2, 3)])
    monkeypatch.setattr(rough_air, "changes", lambda before, after: np.array([0.15, 0.2, 0.1]))
    monkeypatch.setattr(rough_air, "scatter_of_change", lambda before, after: scatter)
    assert (process_noise_that_stands(ledger, root, held)[1] is not None) is stands
