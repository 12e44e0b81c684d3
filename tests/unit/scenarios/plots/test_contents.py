"""What the figures draw is what the results say: degrees, gaps, bounds, errors, clipped values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.estimate import Outcome
from ident.flying_qualities.stability_margins import NORMAL_HALF_WIDTH
from scenarios.plots.comparisons import (
    ComparisonRow,
    EquivalentRow,
    figure_comparison,
    figure_equivalents,
)
from scenarios.plots.display import SIMULATED_DATA, course, sound_samples
from scenarios.plots.estimates import (
    figure_correlation,
    figure_innovations,
    figure_parameter_histories,
    figure_poles,
)
from scenarios.plots.signals import (
    MethodOutputs,
    figure_ballistic_coefficient,
    figure_fit,
    figure_record,
    figure_trajectory,
    response_of,
)
from sim.errors import ModelError
from sim.record import Hold
from tests.unit.scenarios.plots.conftest import Study

DEGREES = 180.0 / np.pi
POUND = 4.8824276  # kg/m2 in one lb/ft2


def curve(panel: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Data of the line with this label."""
    (line,) = [line for line in panel.lines if line.get_label() == label]
    return np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)


def points(panel: Axes, label: str) -> list[tuple[float, float]]:
    """First point of every line with this label, in the order of drawing."""
    return [
        (float(np.asarray(line.get_xdata())[0]), float(np.asarray(line.get_ydata())[0]))
        for line in panel.lines
        if line.get_label() == label
    ]


def texts(figure: Figure) -> list[str]:
    """All texts in the panels of a figure and their captions."""
    return [text.get_text() for panel in figure.axes for text in panel.texts] + [
        panel.get_title(loc="left") for panel in figure.axes
    ]


def test_record_is_drawn_in_degrees_without_missing_samples(rigid: Study) -> None:
    figure = figure_record(rigid.record)
    elevator, alpha, _ = figure.axes
    assert elevator.lines[0].get_drawstyle() == "steps-post"
    assert np.array_equal(
        np.asarray(elevator.lines[0].get_ydata()), DEGREES * rigid.record["elevator"].values
    )
    channel = rigid.record["alpha"]
    lost = np.count_nonzero(~channel.valid)
    time, values = curve(alpha, "measured")
    assert lost > 0
    assert np.array_equal(time, rigid.record.time[channel.valid])
    assert np.array_equal(values, DEGREES * channel.values[channel.valid])
    assert f"measured, {lost} of {len(channel.valid)} samples missing" in texts(figure)


def test_linear_input_is_drawn_linear(rigid: Study) -> None:
    figure = figure_record(replace(rigid.record, hold=Hold.LINEAR))
    assert figure.axes[0].lines[0].get_drawstyle() == "default"


def test_fit_shows_response_truth_and_residual(rigid: Study) -> None:
    estimate, channel = rigid.estimate, rigid.record["alpha"]
    figure = figure_fit(
        rigid.record, [response_of(estimate)], rigid.truth, noise_std={"alpha": 0.002}
    )
    above, below = figure.axes[:2]
    predicted = DEGREES * (channel.values - rigid.history.innovation[0])
    _, shown = curve(above, "EKF, one sample ahead")
    assert np.allclose(shown[channel.valid], predicted[channel.valid], rtol=0, atol=1e-12)
    assert np.all(np.isnan(shown[~channel.valid]))
    assert np.array_equal(curve(above, "true")[1], DEGREES * rigid.truth.outputs["alpha"])
    residual = np.asarray(below.lines[-1].get_ydata(), dtype=float)
    assert np.allclose(
        residual[channel.valid],
        DEGREES * rigid.history.innovation[0, channel.valid],
        rtol=0,
        atol=1e-12,
    )
    assert np.all(np.isnan(residual[~channel.valid]))
    (band,) = [patch for patch in below.patches if patch.get_label() == "±2σ of the sensor noise"]
    ends = band.get_extents().transformed(below.transData.inverted())
    assert (ends.y0, ends.y1) == pytest.approx((-2.0 * DEGREES * 0.002, 2.0 * DEGREES * 0.002))
    assert not [
        patch for patch in figure.axes[3].patches if "sensor noise" in str(patch.get_label())
    ]


def test_fit_leaves_out_channels_of_which_no_response_speaks(rigid: Study) -> None:
    response = MethodOutputs("one", {"q": rigid.truth.outputs["q"]})
    assert len(figure_fit(rigid.record, [response]).axes) == 2
    with pytest.raises(ModelError, match="nothing to draw"):
        figure_fit(rigid.record, [])


def test_a_response_that_runs_away_does_not_flatten_the_measurement(
    rigid: Study, broken: Study
) -> None:
    figure = figure_fit(rigid.record, [response_of(broken.estimate)], rigid.truth)
    assert texts(figure).count("a response leaves the panel") == 2
    low, high = figure.axes[0].get_ylim()
    assert high - low < 5.0 * DEGREES * np.ptp(rigid.truth.outputs["alpha"])


def test_bounds_are_those_of_the_predicted_covariance(rigid: Study) -> None:
    history = rigid.history
    figure = figure_innovations(history, rigid.estimate.output_names, ("rad", "rad/s"))
    left = figure.axes[0]
    valid = history.valid[0]
    # H picks alpha, the first state, so (H P H' + R)_11 = P_11 + R_11.
    bound = 2.0 * np.sqrt(
        history.predicted_covariance[valid, 0, 0] + rigid.estimate.noise_std[0] ** 2
    )
    assert np.allclose(curve(left, "±2σ bounds")[1], DEGREES * bound, rtol=1e-9)
    outside = 100.0 * np.mean(np.abs(history.innovation[0, valid]) > bound)
    assert any(f"{outside:.1f} % outside" in text for text in texts(figure))


def test_autocorrelation_counts_only_pairs_of_samples(rigid: Study) -> None:
    history = rigid.history
    panel = figure_innovations(
        history, rigid.estimate.output_names, ("rad", "rad/s"), lags=12
    ).axes[1]
    valid = history.valid[0]
    e = history.innovation[0] / history.innovation_std[0]
    pairs = [
        [(i, i + k) for i in range(len(e) - k) if valid[i] and valid[i + k]] for k in range(1, 13)
    ]
    r = [sum(e[i] * e[j] for i, j in some) / np.sum(e[valid] ** 2) for some in pairs]
    band = [NORMAL_HALF_WIDTH * np.sqrt(len(some)) / np.count_nonzero(valid) for some in pairs]
    bars, area = panel.collections[1], panel.collections[0]
    assert [float(np.asarray(path.vertices)[1, 1]) for path in bars.get_paths()] == pytest.approx(
        r, abs=1e-12
    )
    vertices = np.asarray(area.get_paths()[0].vertices)
    assert {round(float(y), 9) for x, y in vertices if y > 0} == {round(b, 9) for b in band}
    assert f"{np.count_nonzero(np.abs(r) > np.array(band))} of 12 lags outside" in texts(
        panel.figure  # type: ignore[arg-type]
    )


def test_parameters_over_time_with_truth_published_and_prior(rigid: Study) -> None:
    estimate = rigid.estimate
    true = {name: rigid.truth.parameters[name].value for name in estimate.names}
    published = {"Cm_de": (-2.25619, 0.00289), "CL_q": (-14.0, None)}
    figure = figure_parameter_histories(
        rigid.history, estimate.names, estimate.units, true, published, {"CL_q": (-17.6, 7.0)}
    )
    assert len(figure.axes) == 6
    for name, panel in zip(estimate.names, figure.axes, strict=True):
        assert curve(panel, "true")[1] == pytest.approx(true[name])
        assert curve(panel, "estimate")[1][-1] == pytest.approx(estimate.value(name))
        low, high = panel.get_ylim()
        assert low < min(true[name], estimate.value(name) - 2 * estimate.sigma(name))
        assert high > max(true[name], estimate.value(name) + 2 * estimate.sigma(name))
    # Printed 0.32 from the truth, where the filter's sigma is 0.01: an arrow with the value.
    assert "−2.256" in texts(figure)


def test_a_filter_that_broke_down_is_drawn_to_its_last_sound_sample(broken: Study) -> None:
    assert broken.estimate.outcome is not Outcome.CONVERGED
    sound = sound_samples(broken.history)
    assert 0 < sound < len(broken.history.time)
    estimate = broken.estimate
    figure = figure_parameter_histories(broken.history, estimate.names, estimate.units)
    assert len(curve(figure.axes[0], "estimate")[0]) == sound
    assert all("ends at" in panel.get_title(loc="left") for panel in figure.axes)
    for panel in figure.axes:
        assert np.all(np.isfinite(panel.get_ylim()))


def test_a_gap_at_the_end_is_no_breakdown(rigid: Study) -> None:
    history = rigid.history
    valid = history.valid.copy()
    valid[:, -20:] = False
    assert sound_samples(replace(history, valid=valid)) == len(history.time)


def test_no_sound_sample_at_all(rigid: Study) -> None:
    history, n = rigid.history, len(rigid.history.names)
    nothing = replace(
        history,
        valid=np.zeros_like(history.valid),
        transition=np.broadcast_to(np.eye(n), history.transition.shape),
    )
    assert len(course(nothing, "CL_q").time) == 0
    figure = figure_parameter_histories(nothing, rigid.estimate.names, rigid.estimate.units)
    assert sum("no sound sample" in text for text in texts(figure)) == 6
    assert "no sample was used" in texts(
        figure_innovations(nothing, rigid.estimate.output_names, ("rad", "rad/s"))
    )


def test_ballistic_coefficient_and_its_error_in_pounds(falls: dict[str, Study]) -> None:
    histories = {label: study.history for label, study in falls.items()}
    true = falls["2 Taylor terms"].truth.parameters["beta"].value
    figure = figure_ballistic_coefficient(histories, true)
    assert len(figure.axes) == 4
    for column, (label, study) in enumerate(falls.items()):
        estimate = study.estimate
        assert curve(figure.axes[column], "estimate")[1][-1] == pytest.approx(
            estimate.value("beta") / POUND, rel=1e-6
        )
        error = (estimate.value("beta") - true) / POUND
        below = figure.axes[2 + column]
        assert np.asarray(below.lines[1].get_ydata())[-1] == pytest.approx(error, rel=1e-4)
        assert curve_bounds(below) == pytest.approx(2.0 * estimate.sigma("beta") / POUND, rel=1e-6)
        assert label in texts(figure)
        sigmas = (estimate.value("beta") - true) / estimate.sigma("beta")
        assert any(f"({sigmas:+.1f} σ)".replace("-", "−") in text for text in texts(figure))
    drifting = true + np.linspace(0.0, 50.0, len(histories["2 Taylor terms"].time))
    drifted = figure_ballistic_coefficient(histories, drifting)
    assert np.allclose(curve(drifted.axes[0], "true")[1], drifting / POUND, rtol=1e-6)
    assert len(figure_ballistic_coefficient(histories).axes) == 2


def curve_bounds(panel: Axes) -> float:
    """Upper bound of the error at the end."""
    return max(
        float(np.asarray(line.get_ydata())[-1])
        for line in panel.lines
        if line.get_label() == "±2σ bounds of the error"
    )


def test_trajectory_with_and_without_truth(falls: dict[str, Study]) -> None:
    histories = {label: study.history for label, study in falls.items()}
    study = falls["3 Taylor terms"]
    figure = figure_trajectory(study.record, histories, study.truth)
    altitude, error = figure.axes[:2]
    assert np.allclose(curve(altitude, "true")[1], study.truth.states["altitude"] / 1000.0)
    assert np.allclose(curve(altitude, SIMULATED_DATA)[1], study.record["altitude"].values / 1000.0)
    assert np.allclose(
        np.asarray(error.lines[1].get_ydata()),
        falls["2 Taylor terms"].history.mean[0] - study.truth.states["altitude"],
    )
    assert len(figure_trajectory(study.record, histories).axes) == 2


# The paper's estimates of the rigid aircraft without process noise, beside values of our own
# making.
ROWS = (
    ComparisonRow("CL_alpha", 2.922, 2.911, 0.0137, 2.9096, 0.00764),
    ComparisonRow("Cm_de", -2.578, -2.580, 0.002, -2.25619, 0.00289),
    ComparisonRow("CL_q", -14.7, -14.9, 0.8, -22.7217, 0.75708),
    ComparisonRow("Cm_q", -34.75, -34.9, 0.1, -38.3583),
)


def test_comparison_in_own_sigmas_clips_what_is_far_off() -> None:
    figure = figure_comparison(ROWS)
    written = texts(figure)
    assert "+111 σ" in written
    assert "−11 σ" in written
    assert "+12.5 %" in written
    assert "−10.4 %" in written  # no deviation is printed: no mark, but the error in per cent
    (panel,) = figure.axes
    ours = sorted(x for x, _ in points(panel, "this study"))
    assert ours == pytest.approx(sorted((row.estimate - row.true) / row.std for row in ROWS))
    assert all(
        np.all(np.abs(np.asarray(line.get_xdata(), dtype=float)) <= panel.get_xlim()[1])
        for line in panel.lines
    )
    assert panel.get_yticklabels()[0].get_text() == "$C_{mq}$"


def test_comparison_without_published_values() -> None:
    figure = figure_comparison([replace(row, published=None, published_std=None) for row in ROWS])
    assert "published" not in texts(figure)
    with pytest.raises(ModelError, match="nothing to draw"):
        figure_comparison([])


def test_equivalents_stand_beside_each_other() -> None:
    rows = [
        EquivalentRow("AC1", "CL_alpha", "1/rad", 2.922, 2.478, 2.48, 0.01, 2.4927, 0.006445),
        EquivalentRow("AC2", "CL_alpha", "1/rad", 2.922, 1.654, 1.66, 0.01),
        EquivalentRow("AC2", "Cm_q", "1/rad", -34.75, -28.1, -28.0, 3.0),
    ]
    figure = figure_equivalents(rows)
    first, second = figure.axes
    assert [label.get_text() for label in first.get_xticklabels()] == ["AC1", "AC2"]
    assert [y for _, y in points(first, "condensed")] == [2.478, 1.654]
    assert [x for x, _ in points(second, "condensed")] == [0.8]


@pytest.mark.long
def test_large_correlations_are_framed_and_undefined_ones_grey() -> None:
    matrix = np.array(
        [
            [1.0, 0.95, -0.5, np.nan],
            [0.95, 1.0, -0.91, np.nan],
            [-0.5, -0.91, 1.0, np.nan],
            [np.nan] * 4,
        ]
    )
    figure = figure_correlation(["CL_alpha", "CL_q", "Cm_q", "delay"], matrix)
    panel = figure.axes[0]
    assert [text.get_text() for text in panel.texts] == [".95", "−.50", "−.91"]
    assert len([patch for patch in panel.patches if not patch.get_fill()]) == 2
    assert len([patch for patch in panel.patches if patch.get_fill()]) == 3
    assert any(text.get_text().startswith("2 of 6 pairs") for text in figure.texts)
    small = figure_correlation(["CL_alpha", "CL_q"], np.array([[1.0, 0.49], [0.49, 1.0]])).axes[0]
    assert not small.texts, "what is below a half carries no number"
    with pytest.raises(ModelError, match="two parameters or more"):
        figure_correlation(["CL_alpha"], np.eye(1))


def test_poles_are_roots_of_the_estimate_with_the_scatter_of_its_covariance() -> None:
    """Oracle: a first-order roll, whose pole is L_p and whose scatter is that of L_p."""
    from scenarios.identification.files import poles_of
    from scenarios.identification.identify import identify
    from tests.every_model import case_of

    case = case_of("own", 1)
    found = identify(case.record, case.vehicle, "output-error")
    poles = poles_of(found)
    assert poles is not None
    at, draws = poles
    value, sigma = found.estimate.value("L_p"), found.estimate.sigma("L_p")
    assert np.min(np.abs(at - value)) < 1e-9
    roll = draws[np.arange(len(draws)), np.argmin(np.abs(draws - value), axis=1)].real
    assert np.std(roll) == pytest.approx(sigma, rel=0.35)
    panel = figure_poles(at, draws, "poles").axes[0]
    crosses = [line for line in panel.lines if line.get_label() == "estimate"]
    assert np.any(np.isclose(np.asarray(crosses[0].get_xdata(), dtype=float), value))
    assert poles_of(replace(found, system=None)) is None
