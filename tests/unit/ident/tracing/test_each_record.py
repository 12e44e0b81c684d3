"""What each record says of an effect: one Gauss-Newton step against fits in which each record has
its own parameter.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.intervals import inverse_information
from ident.tracing.between_records import parameters_by_record, widened_by_scatter
from ident.tracing.diagnosis import Quantity
from ident.tracing.fitted_model import FittedModel, fit_set, start_from
from ident.tracing.problem import TraceProblem
from sim.declaration.proposal import Traceable
from sim.effects.sensor_path.sensor_calibration import SensorDrift, SensorScale
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.record import Record
from tests.tracing_problem import fit_of, part, planted, problem_of

LAG, SCALE = SensorLag("q"), SensorScale("nz")


def flown(lag: float, scale: float, seed: int) -> Record:
    return planted(
        [LAG, SCALE], {"sensor-lag:q.time_constant": lag, "sensor-scale:nz.scale": scale}, seed
    )


def fitted_apart(problem: TraceProblem, fitted: FittedModel, name: str) -> list[Quantity]:
    """The second writing: a fit to the end in which each record has this parameter for itself."""
    apart = fit_set(problem.data, fitted.effects, problem.roughly, start_from(fitted), apart=[name])
    assert apart is not None
    normal, _ = apart.fit.normal_equations()
    sigma = np.sqrt(np.diag(inverse_information(normal, apart.fit.theta)[0]))
    at = [
        apart.fit.layout.names.index(f"{name}, record {r + 1}") for r in range(len(problem.records))
    ]
    return [Quantity(float(apart.fit.theta[i]), float(sigma[i]), "") for i in at]


@pytest.mark.parametrize("effects", [(LAG,), (SCALE, LAG)], ids=["alone", "beside another"])
def test_values_are_those_of_a_fit_in_which_each_record_has_its_own(
    effects: tuple[Traceable, ...],
) -> None:
    """Records of different lengths; lags of 0.058 s and 0.062 s, some sigmas apart."""
    scale = 1.2 if len(effects) > 1 else 1.0
    problem = problem_of(
        [
            flown(0.058, scale, 1),
            part(flown(0.062, scale, 2), slice(0, 350)),
            flown(0.058, scale, 3),
        ]
    )
    fitted = fit_of(problem, effects)
    found = parameters_by_record(fitted, LAG)
    expected = fitted_apart(problem, fitted, "sensor-lag:q.time_constant")
    assert [set(each) for each in found] == [{"time_constant"}] * 3
    for mine, theirs in zip(found, expected, strict=True):
        assert mine["time_constant"].unit == "s"
        assert mine["time_constant"].value == pytest.approx(theirs.value, abs=0.1 * theirs.std)
        assert mine["time_constant"].std == pytest.approx(theirs.std, rel=0.04)
    values = [each["time_constant"].value for each in found]
    assert values == pytest.approx([0.058, 0.062, 0.058], abs=0.002)
    assert values[1] - max(values[0], values[2]) > 2.0 * found[1]["time_constant"].std
    joint = fitted.values.shared["sensor-lag:q.time_constant"]
    assert min(values) < joint < max(values)


def test_values_of_records_that_agree_do_so_within_their_sigmas() -> None:
    fitted = fit_of(problem_of([flown(0.06, 1.0, seed) for seed in (1, 2, 3)]), [LAG])
    found = parameters_by_record(fitted, LAG)
    away = [(each["time_constant"].value - 0.06) / each["time_constant"].std for each in found]
    assert np.max(np.abs(away)) < 4.0


def test_one_record_says_nothing_beside_itself_and_neither_does_what_each_has_for_itself() -> None:
    alone = fit_of(problem_of([flown(0.06, 1.0, 1)]), [LAG])
    assert parameters_by_record(alone, LAG) == ()
    drift = SensorDrift("q", "rad/s", 5e-4)
    both = fit_of(problem_of([flown(0.06, 1.0, seed) for seed in (1, 2)]), [drift, LAG])
    assert parameters_by_record(both, drift) == ()
    assert len(parameters_by_record(both, LAG)) == 2


def test_sigmas_of_an_effect_are_widened_where_its_values_by_record_scatter() -> None:
    """Values 3 sigmas on both sides of their mean: chi-squared of 18 with one degree of freedom."""
    sizes = {"arm": Quantity(10.0, 0.1, "m"), "other": Quantity(1.0, 0.2, "s")}
    apart = [{"arm": Quantity(10.0 + side * 0.6, 0.2, "m")} for side in (-1.0, 1.0)]
    alike = [{"arm": Quantity(10.0 + side * 0.1, 0.2, "m")} for side in (-1.0, 1.0)]
    widened = widened_by_scatter(sizes, apart)
    assert widened["arm"].value == 10.0 and widened["arm"].std == pytest.approx(0.1 * 18.0**0.5)
    assert widened["other"] == sizes["other"]
    assert widened_by_scatter(sizes, alike) == widened_by_scatter(sizes, ()) == sizes


def test_widened_sigmas_cover_sizes_that_differ_from_record_to_record() -> None:
    """Sizes of records scatter by twice their sigmas: two sigmas of the mean hold 95 % of many."""
    rng = np.random.default_rng(5)
    held, count, records = 0, 2000, 4
    for _ in range(count):
        values = 10.0 + rng.normal(scale=np.hypot(0.2, 0.4), size=records)
        each = [{"arm": Quantity(float(value), 0.2, "m")} for value in values]
        mean = {"arm": Quantity(float(values.mean()), 0.2 / records**0.5, "m")}
        arm = widened_by_scatter(mean, each)["arm"]
        held += abs(arm.value - 10.0) < 2.0 * arm.std
    assert 0.83 < held / count < 0.97  # without: 0.63
