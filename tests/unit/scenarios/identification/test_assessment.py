"""What stands beside an estimate: bounds that act, ties, profile-likelihood intervals, records that
were held out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Outcome
from scenarios.files.user_models import Constraints
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment import IdentificationResult, Options, RecordFit
from scenarios.identification.cautions import too_short
from scenarios.identification.files import figure_spectra, identification_figures
from scenarios.identification.identify import identify
from scenarios.identification.report import (
    bound_lines,
    constraints_content,
    estimated_noise,
    fits_content,
    fits_table,
    interval_sentences,
    intervals_content,
    intervals_table,
    noise_phrase,
)
from scenarios.preparation.declared_model import model_of_file
from scenarios.preparation.recording import isolated_outliers
from sim.declaration.compile import compile_model
from sim.declaration.model import Tie
from sim.errors import DeclarationError
from sim.record import Channel, Hold, Record
from tests.every_model import Case, case_of


def laid_down(case: Case, **changes: object) -> VehicleFile:
    return replace(case.vehicle, constraints=Constraints(**changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["output-error", "equation-error", "frequency-domain"])
def test_a_bound_that_acts_is_held_and_said(method: str) -> None:
    """Sigmas are those of a fit with the parameter known, and the parameter is none of the rows."""
    case = case_of("own", 1)
    vehicle = laid_down(case, bounds={"L_p": (-2.2, 0.0)})
    found = identify(case.record, vehicle, method)
    held = identify(
        case.record,
        replace(laid_down(case, fixed=("L_p",)), own=vehicle.own.with_values({"L_p": -2.2})),  # type: ignore[union-attr]
        method,
    )
    assert found.estimate.outcome is Outcome.AT_BOUND and any(
        "at its bound" in caution for caution in found.cautions
    )
    assert [(each.name, each.value, each.side) for each in found.at_bounds] == [
        ("L_p", -2.2, "lower")
    ]
    assert [row.name for row in found.rows] == ["L_da"]
    assert found.estimate.value("L_da") == pytest.approx(held.estimate.value("L_da"), rel=1e-4)
    assert found.estimate.sigma("L_da") == pytest.approx(held.estimate.sigma("L_da"), rel=1e-3)
    assert bound_lines(found.at_bounds, found.tied) == ["L_p is at its lower bound, -2.2 1/s"]
    content = constraints_content(vehicle.constraints, found.tied, found.at_bounds)["constraints"]
    assert content == {
        "bounds": {"L_p": {"low": -2.2, "high": 0.0}},
        "at_bound": {"L_p": {"value": -2.2, "unit": "1/s", "bound": "lower"}},
    }


def test_bounds_that_do_not_act_change_nothing() -> None:
    case = case_of("own", 1)
    free, found = (
        identify(case.record, case.vehicle, "output-error"),
        identify(case.record, laid_down(case, bounds={"L_p": (-9.0, 0.0)}), "output-error"),
    )
    assert (
        found.estimate.outcome is Outcome.CONVERGED
        and np.array_equal(found.estimate.values, free.estimate.values)
        and not found.at_bounds
    )
    assert "bounded by the vehicle file: L_p from -9 to 0 1/s" in found.notes


@pytest.mark.parametrize(
    "method", ["output-error", pytest.param("ekf", marks=pytest.mark.slow), "frequency-domain"]
)
def test_a_tied_parameter_follows_with_its_sigma(method: str) -> None:
    case = case_of("own", 2)
    tie = Tie("L_da", (("L_p", -7.0 / 2.4),))
    found = identify(case.record, laid_down(case, ties=(tie,)), method)
    (row,) = found.tied
    assert row.estimate == pytest.approx(
        -7.0 / 2.4 * found.estimate.value("L_p")
    ) and row.std == pytest.approx(7.0 / 2.4 * found.estimate.sigma("L_p"))
    assert abs(row.estimate - 7.0) < 4.0 * row.std and "L_da" not in found.fixed
    assert "tied by the vehicle file: L_da = -2.91667 L_p" in found.notes


def test_what_filters_cannot_keep_is_refused() -> None:
    case, loes = case_of("own"), case_of("loes")
    with pytest.raises(
        DeclarationError, match="a filter keeps no bounds, and the vehicle file bounds L_p"
    ):
        identify(case.record, laid_down(case, bounds={"L_p": (-9.0, 0.0)}), "ekf")
    with pytest.raises(DeclarationError, match="the bank of delays estimates every derivative"):
        identify(loes.record, laid_down(loes, fixed=("M_q",)), "ekf")
    with pytest.raises(
        DeclarationError,
        match=(
            "ekf has no likelihood of whole records that a profile could follow; use --method "
            "output-error"
        ),
    ):
        identify(case.record, case.vehicle, "ekf", options=Options(profile=()))
    with pytest.raises(DeclarationError, match="output-error has no band of frequencies"):
        identify(case.record, case.vehicle, "output-error", options=Options(band=(0.1, 2.0)))
    with pytest.raises(DeclarationError, match="2 to 1 Hz is no band"):
        identify(case.record, case.vehicle, "frequency-domain", options=Options(band=(2.0, 1.0)))


@pytest.mark.parametrize("method", ["output-error", "frequency-domain"])
def test_intervals_stand_beside_the_sigmas(method: str) -> None:
    case = case_of("own", 3)
    found = identify(case.record, case.vehicle, method, options=Options(profile=("L_p",)))
    (interval,) = found.intervals
    assert (
        interval.name == "L_p"
        and interval.agrees
        and interval.low is not None
        and interval.high is not None
    )
    assert interval.low < found.estimate.value("L_p") < interval.high
    content = intervals_content(found.intervals)["intervals"]
    assert content["parameters"]["L_p"]["agrees_with_sigma"] and set(content["parameters"]) == {
        "L_p"
    }
    assert intervals_table(found.intervals, {"L_p": "1/s"}).rows[-1][0] == "L_p"
    with pytest.raises(DeclarationError, match=r"no parameter 'L_q' is estimated; did you mean"):
        identify(case.record, case.vehicle, method, options=Options(profile=("L_q",)))
    pressed = laid_down(case, bounds={"L_p": (-2.2, 0.0)})
    with pytest.raises(
        DeclarationError,
        match="L_p is fixed, tied or at its bound: no interval is its own; use one of L_da",
    ):
        identify(case.record, pressed, method, options=Options(profile=("L_p",)))


def test_open_and_skewed_intervals_are_told() -> None:
    from ident.statistics.profile_likelihood import ProfileInterval

    some = [
        ProfileInterval("lag", 1.0, 0.5, 0.4, None),
        ProfileInterval("gain", 1.0, 0.1, 0.85, 1.4, better=1.0),
    ]
    assert intervals_table(some, {}).rows[0][2] == "open"
    lines = interval_sentences(some)
    assert "not determined on that side by these data: lag is open above" in lines
    assert "the interval is not +- 2 sigma: gain; quote the interval" in lines
    assert lines[-1].startswith("likelier values than the estimate were found along gain")
    assert intervals_content(some)["intervals"]["parameters"]["lag"] == {
        "low": 0.4,
        "agrees_with_sigma": False,
    }


def test_records_held_out_are_simulated_with_what_was_found() -> None:
    """The errors are those of the definition, and a record whose aircraft is another one is
    predicted worse.
    """
    one, two, other = (case_of("own", seed) for seed in (4, 5, 6))
    spoiled = replace(
        other.record,
        name="spoiled",
        inputs=tuple(replace(each, values=1.5 * each.values) for each in other.record.inputs),
    )
    found = identify(
        one.record, one.vehicle, "output-error", [two.record], held_out=[other.record, spoiled]
    )
    assert [each.held_out for each in found.fits] == [False, False, True, True]
    fitted, _, held, worse = found.fits
    z, y = held.record["p"].values, held.simulated[held.outputs.index("p")]
    assert held.figures is not None and worse.figures is not None and fitted.figures is not None
    assert held.figures.fit_percent("p") == pytest.approx(
        100.0 * (1.0 - np.sqrt(np.mean((z - y) ** 2)) / np.std(z))
    )
    assert held.figures.r2["p"] == pytest.approx(1.0 - np.mean((z - y) ** 2) / np.var(z))
    assert held.figures.theil["p"] == pytest.approx(
        np.sqrt(np.mean((z - y) ** 2)) / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    )
    assert (
        held.figures.rmse["p"] == pytest.approx(fitted.figures.rmse["p"], rel=0.2)
        and worse.figures.rmse["p"] > 3.0 * held.figures.rmse["p"]
    )
    rows = fits_table(found.fits).rows
    assert len(rows) == 2 * 4 and rows[-1][:2] == ("spoiled", "held out")
    assert [each["held_out"] for each in fits_content(found.fits)["records_fitted"]] == [
        False,
        False,
        True,
        True,
    ]


def test_spectra_of_a_record_with_gaps() -> None:
    """Gaps are bridged by straight lines, as the fit does; a record with one in every output is
    drawn all the same.
    """
    time = 0.02 * np.arange(200)
    line = 1.0 + 2.0 * time
    outputs = [
        Channel.of(name, "rad", np.where(np.isin(np.arange(200), gap), np.nan, line))
        for name, gap in (("a", [50]), ("b", [60, 61]))
    ]
    each = RecordFit(
        Record(time, (), tuple(outputs), Hold.PREVIOUS, "gaps"),
        ("b", "a"),
        np.zeros((2, 200)),
        None,
        False,
    )
    figure = figure_spectra(each, {}, (0.5, 2.0))
    drawn = [
        next(curve for curve in panel.lines if curve.get_label() == "measured").get_ydata()
        for panel in figure.axes
    ]
    expected = np.degrees(np.abs(np.fft.rfft(line)[1:100])) / np.sqrt(200.0)
    assert len(drawn) == 2 and all(np.allclose(curve, expected) for curve in drawn)


def drawn(found: IdentificationResult, measured: Record) -> set[str]:
    return {stem for stem, make in identification_figures(found, measured) if make().axes}


@pytest.mark.slow
def test_figures_of_a_bank_and_of_every_record() -> None:
    """A delay that a bank of filters found has no history to be drawn; each record has its figure,
    a fit in the frequency domain its spectra.
    """
    loes, own = case_of("loes"), case_of("own", 4)
    bank = identify(loes.record, loes.vehicle, "ekf", held_out=[case_of("loes", 1).record])
    found = identify(
        own.record,
        own.vehicle,
        "frequency-domain",
        [case_of("own", 5).record],
        held_out=[case_of("own", 6).record],
    )
    assert drawn(bank, loes.record) == {
        "record",
        "fit",
        "held_out",
        "parameters",
        "innovations",
        "correlation",
    }
    assert drawn(found, own.record) == {
        "record",
        "fit",
        "fit_2",
        "held_out",
        "spectra",
        "correlation",
    }


def test_an_output_that_no_record_has_has_no_outliers() -> None:
    """A record to predict may lack an output that was fitted."""
    case = case_of("rigid", 1)
    record = case.record
    fewer = replace(
        record,
        outputs=tuple(each for each in record.outputs if each.name != record.output_names[-1]),
    )
    rows = np.array([record[name].values for name in record.output_names])
    assert isolated_outliers(record.output_names, [rows], [fewer]) == [{}]


def test_a_record_shorter_than_a_period_of_the_motion_has_a_caution() -> None:
    case = case_of("rigid", 1)
    system = compile_model(model_of_file(case.vehicle))
    first = case.record.time[0]
    part = case.record.window(first, first + 0.4)
    (caution,) = too_short([part], system)
    assert "shorter than a period of the motion" in caution
    assert too_short([case.record], system) == too_short([part, case.record], system) == ()


def test_sensor_noise_is_told_apart_from_what_the_model_misses() -> None:
    case = case_of("own", 3)
    found = identify(case.record, case.vehicle, "output-error")
    assert estimated_noise(found) == {} and noise_phrase(found) == ""
    (fit,) = found.fits
    row, channel = fit.outputs.index("p"), fit.record["p"]
    noise = float(np.std(channel.values - fit.simulated[row]))
    missed = fit.simulated.copy()
    missed[row] += 3.0 * noise * np.sin(np.linspace(0.0, 20.0, len(fit.record)))
    failed = tuple(
        replace(test, p_value=1e-12) if test.channel == "p" else test for test in found.tests
    )
    coloured = replace(found, fits=(replace(fit, simulated=missed),), tests=failed)
    assert set(estimated_noise(coloured)) == {"p"} and estimated_noise(coloured)[
        "p"
    ] == pytest.approx(noise, rel=0.15)
    assert noise_phrase(coloured).startswith(
        "sensor noise (estimated from high frequencies, 1 sigma): p "
    )
