"""Figures of a diagnosis: what they draw, and that they stand odd results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ident.tracing.diagnosis import Candidate, FittedRecord, Quantity, Verdict
from scenarios.plots.display import (
    NamedEffects,
    Replicated,
    coherence_level,
    input_coherence,
    reason,
    spectrum,
)
from scenarios.plots.drawing import figure_png
from scenarios.plots.style import BLUE
from scenarios.plots.tracing import (
    figure_derivatives,
    figure_evidence,
    figure_held_out,
    figure_replication,
    figure_residuals,
    figure_spectra,
)
from tests.diagnoses import BALLISTIC, NOISE, tracing_of


@pytest.fixture(scope="module")
def fitted() -> FittedRecord:
    return tracing_of(Verdict.TRACED, count=200).diagnosis.fitted[0]


def test_residuals_before_and_after_share_one_scale(fitted: FittedRecord) -> None:
    figure = figure_residuals(fitted, NOISE)
    panels = figure.axes
    assert len(panels) == 6
    for left, right in zip(panels[::2], panels[1::2], strict=True):
        assert left.get_ylim() == right.get_ylim()
    captions = [panel.get_title(loc="left") for panel in panels]
    assert all(
        text.startswith(("before", "after")[place % 2]) for place, text in enumerate(captions)
    )
    (ring,) = [line for line in panels[0].lines if line.get_label() == "set aside"]
    assert ring.get_xdata() == pytest.approx([fitted.record.time[50]])
    # Missing samples are not drawn.
    (dots,) = [line for line in panels[0].lines if line.get_label() == "residual"]
    assert len(np.asarray(dots.get_xdata())) == int(fitted.record["alpha"].valid.sum()) == 197


def test_residuals_of_an_unchanged_model_have_one_column(fitted: FittedRecord) -> None:
    assert (
        len(figure_residuals(replace(fitted, before=fitted.after * (1.0 + 1e-4)), NOISE).axes) == 3
    )


def test_channel_that_a_record_lacks_is_left_out(fitted: FittedRecord) -> None:
    lean = replace(fitted, record=fitted.record.only(["nz"]))
    assert len(figure_residuals(lean, NOISE).axes) == 2
    assert len(figure_spectra(lean, NOISE).axes) == 1


def test_held_out_shows_measured_and_both_predictions() -> None:
    prediction = tracing_of(Verdict.TRACED, count=200).diagnosis.predictions[0]
    figure = figure_held_out(prediction, NOISE)
    first = len(prediction.record.inputs)
    for channel, panel in zip(prediction.record.inputs, figure.axes, strict=False):
        drawn = np.asarray(panel.lines[0].get_ydata())
        assert drawn == pytest.approx(np.degrees(channel.values)), "inputs stand above the outputs"
    labels = {line.get_label() for line in figure.axes[first].lines}
    assert {"measured", "predicted before", "predicted after"} <= labels
    (after,) = [line for line in figure.axes[first].lines if line.get_label() == "predicted after"]
    assert np.asarray(after.get_ydata()) == pytest.approx(np.degrees(prediction.after[0]))


def test_evidence_has_the_longest_bar_on_top_and_the_claimed_one_blue() -> None:
    candidates = tracing_of(Verdict.PARTIAL).diagnosis.candidates
    figure = figure_evidence(candidates, NamedEffects(("sensor-lag:alpha",), noise_left=True))
    assert len(figure.axes) == 2, "two rounds"
    bars = [bar for bar in figure.axes[0].patches if isinstance(bar, Rectangle)]
    tops = sorted(bars, key=lambda bar: bar.get_y())
    lengths = [bar.get_width() for bar in tops]
    assert lengths == sorted(lengths) and len(lengths) == 4
    assert to_hex(tops[-1].get_facecolor()) == BLUE.lower()
    assert {to_hex(bar.get_facecolor()) for bar in tops[:-1]} & {BLUE.lower()} == set()
    assert (
        figure.axes[1].get_title(loc="left")
        == "round 2, added to sensor-lag:alpha; nothing more was needed"
    )


def candidate(name: str, weight: float, **told: object) -> Candidate:
    return replace(Candidate(1, (), name, weight + 5.0, weight, True, {}), **told)  # type: ignore[arg-type]


def rows_of(figure: Figure) -> dict[str, list[str]]:
    """By candidate the texts in its row: log odds, reason."""
    panels = figure.axes
    names = [label.get_text() for label in panels[0].get_yticklabels()]
    at = dict(zip(panels[0].get_yticks().tolist(), names, strict=True))
    out: dict[str, list[str]] = {name: [] for name in names}
    for panel in panels:
        for text in panel.texts:
            if text.get_va() == "center" and text.xy[1] in at:  # type: ignore[attr-defined]
                out[at[text.xy[1]]].append(text.get_text())  # type: ignore[attr-defined]
    return out


def test_evidence_says_beside_each_bar_why_it_was_not_chosen() -> None:
    candidates = [
        candidate("vane-offset", 1531.0),
        candidate("input-delay", 1539.0),
        candidate("actuator-lag", 1528.0, collinear_with=("input-delay",)),
        candidate("guard:lagged-loads", 1400.0),
        candidate("elastic-mode", 800.0, fitted=False),
        candidate("speed-variation", -4.0),
    ]
    figure = figure_evidence(candidates, NamedEffects(("input-delay",), noise_left=True))
    rows = rows_of(figure)
    assert rows == {
        "input-delay": ["1539", "claimed"],
        "vane-offset": ["1531", "lower odds"],
        "actuator-lag": ["1528", "like the claimed, lower odds"],
        "guard:lagged-loads": ["1400", "no effect of the library"],
        "elastic-mode": ["800", "linearised: lower odds"],
        "speed-variation": ["−4.0", "not needed"],
    }
    (panel,) = figure.axes
    bars = [bar for bar in panel.patches if isinstance(bar, Rectangle)]
    assert {bar.get_x() for bar in bars} == {0.0}, "bars begin at no gain"
    gains = sorted((bar.get_width() for bar in bars), reverse=True)
    assert gains == pytest.approx([1539.0, 1531.0, 1528.0, 1400.0, 800.0, -4.0])
    assert panel.get_xscale() == "linear"
    open_bars = [bar for bar in bars if to_hex(bar.get_facecolor()) == "#ffffff"]
    assert len(open_bars) == 1, "what was not fitted is an open bar"


def test_a_longer_bar_than_a_claimed_one_has_lower_odds_in_whole_sets_alone() -> None:
    """A bar of 100 had "lower odds" beside a claimed one of 75."""
    candidates = [
        candidate("input-recorded-late", 100.0, fitted=False),
        candidate("sensor-scale:nz", 75.0, fitted=False),
        candidate("elastic-mode", 19.0),
    ]
    figure = figure_evidence(candidates, NamedEffects(("sensor-scale:nz", "phugoid")))
    assert rows_of(figure) == {
        "input-recorded-late": ["100", "its whole sets: lower odds"],
        "sensor-scale:nz": ["75.0", "claimed"],
        "elastic-mode": ["19.0", "lower odds"],
    }
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "other, linearised",
        "claimed, linearised",
        "other, fitted",
    ]


def test_evidence_shows_a_candidate_once_as_it_was_fitted() -> None:
    twice = [
        candidate("sensor-lag:q", 246.0, fitted=False),
        candidate("sensor-lag:q", 857.0),
        candidate("sensor-lag:q", 700.0),
    ]
    assert rows_of(figure_evidence(twice, NamedEffects(("sensor-lag:q",)))) == {
        "sensor-lag:q": ["857", "claimed"]
    }
    # Also where its signature promised more than the fit brought.
    assert rows_of(figure_evidence([replace(twice[0], weight=900.0), twice[2]])) == {
        "sensor-lag:q": ["700", "not spread evenly"]
    }


def test_evidence_counts_what_it_leaves_out_and_keeps_what_is_named() -> None:
    many = [candidate(f"effect-{number}", 100.0 - number) for number in range(20)] + [
        candidate("hint", 1.0)
    ]
    (panel,) = figure_evidence(many, NamedEffects(hints=("hint",))).axes
    assert (
        "hint" in {label.get_text() for label in panel.get_yticklabels()}
        and len(panel.get_yticks()) == 12
    )
    assert "9 others below" in [text.get_text() for text in panel.texts]


def test_alternatives_are_marked_beside_the_other_claims_and_nothing_more_is_needed_where_noise_is_left() -> (  # noqa: E501
    None
):
    standing = NamedEffects(("a", "b"), {"b": ("c",)}, noise_left=True)
    late = candidate("c", 5.0, within=("a",))
    assert (
        reason(late, standing, [late]) == "an alternative"
        and reason(replace(late, within=()), standing, [late]) != "an alternative"
    )
    last = candidate("d", 5.0, within=("a", "b"))
    assert reason(last, standing, [last]) == "not needed"
    assert reason(last, replace(standing, noise_left=False), [last]) != "not needed"
    # Less probable than its absence: nothing speaks for it beside any set.
    assert (
        reason(replace(last, weight=-1.0), replace(standing, noise_left=False), [last])
        == "not needed"
    )


def test_evidence_of_no_candidate_says_so() -> None:
    assert "no candidate" in figure_evidence(()).axes[0].get_title(loc="left")


def test_derivatives_are_drawn_in_per_cent_and_vague_ones_in_their_sigmas() -> None:
    before = {"Cm_q": Quantity(-20.0, 1.0, "1/rad"), "CL_q": Quantity(0.1, 2.0, "1/rad")}
    after = {"Cm_q": Quantity(-17.0, 0.5, "1/rad"), "CL_q": Quantity(6.1, 1.0, "1/rad")}
    panel = figure_derivatives(before, after).axes[0]
    points = [
        line.get_xdata()
        for line in panel.lines
        if line.get_marker() == "o" and line.get_linestyle() == "None"
    ]
    assert np.asarray(points[-1]) == pytest.approx([15.0, 100.0])
    told = " ".join(panel.get_title(loc="left").split())
    assert "is drawn in per cent of three sigmas, because it was not determined before" in told
    alone = {**before, "CL_de": Quantity(0.1, 1.0, "1/rad")}
    told = " ".join(figure_derivatives(alone, alone).axes[0].get_title(loc="left").split())
    assert " and " in told and told.endswith("because they were not determined")
    texts = {text.get_text() for text in panel.texts}
    assert {"−20.0 ± 1.0", "−17.00 ± 0.50"} <= texts


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_spectrum_of_white_noise_lies_at_its_variance(missing: float) -> None:
    rng = np.random.default_rng(2)
    used = rng.random(4000) >= missing
    hertz, power = spectrum(
        np.where(used, 0.3 * rng.standard_normal(4000), 0.0), 0.02, int(used.sum())
    )
    assert power.mean() == pytest.approx(0.09, rel=0.08)
    assert 0.0 < hertz[0] < hertz[-1] < 25.0 and len(hertz) == len(power)


def test_spectrum_of_a_sine_peaks_at_its_frequency() -> None:
    time = 0.02 * np.arange(1000)
    hertz, power = spectrum(np.sin(2.0 * np.pi * 3.0 * time), 0.02, 1000)
    assert hertz[np.argmax(power)] == pytest.approx(3.0, abs=0.15)


def test_replication_shows_each_record_against_all_together() -> None:
    late = tuple({"time_constant": Quantity(value, 0.004, "s")} for value in (0.058, 0.063, 0.060))
    stop = tuple(
        {"limit": Quantity(np.radians(value), np.radians(0.05), "rad")}
        for value in (0.6, 0.7, 0.65)
    )
    names = ("a.csv", "b.csv", "c.csv, from 7 s")
    effects = [
        Replicated("sensor-lag:alpha", names, late, {"time_constant": Quantity(0.061, 0.002, "s")}),
        Replicated(
            "actuator-saturation",
            names,
            stop,
            {"limit": Quantity(np.radians(0.65), np.radians(0.02), "rad")},
        ),
    ]
    figure = figure_replication(effects)
    first, second = figure.axes
    for panel, values in ((first, [0.058, 0.063, 0.060]), (second, [0.6, 0.7, 0.65])):
        (points,) = [line for line in panel.lines if line.get_marker() == "o"]
        assert np.asarray(points.get_ydata()) == pytest.approx(values)
        assert np.asarray(points.get_xdata()) == pytest.approx([0, 1, 2])
        assert panel.get_xlim() == (-0.5, 2.5)
    (band,) = [patch for patch in second.patches if isinstance(patch, Rectangle)]
    assert (band.get_y(), band.get_y() + band.get_height()) == pytest.approx((0.61, 0.69))
    assert [panel.get_title(loc="left") for panel in figure.axes] == [
        "sensor-lag:alpha",
        "actuator-saturation",
    ]
    assert "deg" in second.get_ylabel() and figure_png(figure).startswith(b"\x89PNG")


def test_replication_stands_records_without_the_parameter_and_sigmas_that_say_nothing() -> None:
    by_record: tuple[dict[str, Quantity], ...] = (
        {"delay": Quantity(0.06, np.inf, "s")},
        {},
        {"delay": Quantity(0.05, 1e300, "s")},
    )
    (panel,) = figure_replication([Replicated("input-delay", ("a", "b", "c"), by_record, {})]).axes
    (points,) = [line for line in panel.lines if line.get_marker() == "o"]
    assert np.asarray(points.get_xdata()) == pytest.approx([0, 2])
    assert np.all(np.isfinite(panel.get_ylim()))


@pytest.mark.long
def test_figures_of_a_fall_and_of_runaway_predictions_can_be_drawn() -> None:
    d = tracing_of(Verdict.UNEXPLAINED, BALLISTIC, channels=("altitude",), count=60).diagnosis
    runaway = replace(d.predictions[0], before=np.full_like(d.predictions[0].before, 1e30))
    for figure in (
        figure_held_out(runaway, d.noise_floor),
        figure_residuals(d.fitted[0], {}),
        figure_spectra(d.fitted[0], {}),
    ):
        assert figure_png(figure).startswith(b"\x89PNG")


def test_coherence_with_the_inputs_is_the_share_of_the_power_that_follows_them() -> None:
    """Oracle: a residual of known shares; what follows two inputs is coherent with both, and white
    noise exceeds the level once in twenty.
    """
    rng = np.random.default_rng(4)
    inputs = rng.standard_normal((2, 20000))
    noise = rng.standard_normal(20000)
    followed = np.roll(inputs[0], 3) + 0.5 * inputs[1]
    shares = input_coherence(followed + noise, inputs, 0.02)[1]
    assert np.mean(shares) == pytest.approx(1.25 / 2.25, abs=0.08)
    assert np.min(input_coherence(followed, inputs, 0.02)[1]) > 0.98
    hertz, alone = input_coherence(noise, inputs, 0.02)
    assert np.mean(alone > coherence_level(2)) == pytest.approx(0.05, abs=0.025)
    assert hertz[0] > 0.0 and hertz[-1] <= 25.0
    for unmoved in (
        input_coherence(0.0 * noise, inputs, 0.02),
        input_coherence(noise, 0.0 * inputs, 0.02),
    ):
        assert np.all(np.isfinite(unmoved[1])) and np.max(unmoved[1]) < 1e-6
