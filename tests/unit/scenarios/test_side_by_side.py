"""Errors of a value against its reference, side by side and in the rows of a study."""

from __future__ import annotations

import pytest

from scenarios.plots.display import StudyValue
from scenarios.studies.declaration import Row, Start


@pytest.mark.parametrize(
    ("estimate", "reference", "percent"),
    [(-1.1, -1.0, -10.0), (-0.9, -1.0, 10.0), (2.2, 2.0, 10.0)],
)
def test_an_error_in_per_cent_has_the_sign_of_the_error(
    estimate: float, reference: float, percent: float
) -> None:
    value = StudyValue(estimate, 0.05, "1/rad", true=reference)
    assert value.percent == pytest.approx(percent)
    assert value.sigmas == pytest.approx((estimate - reference) / 0.05)
    row = Row("Cm_q", "1/rad", estimate, 0.05, true=reference)
    assert (row.percent, row.sigmas) == pytest.approx((value.percent, value.sigmas))


def test_where_modes_are_lacking_the_condensed_value_is_the_reference() -> None:
    value = StudyValue(2.7, 0.1, "1/rad", true=2.9, condensed=2.6)
    assert value.reference == 2.6 and value.sigmas == pytest.approx(1.0)
    row = Row("CL_alpha", "1/rad", 2.7, 0.1, true=2.9, condensed=2.6, published=Start(2.8, 0.2))
    assert row.reference == 2.6 and row.sigmas == pytest.approx(1.0)
    assert row.published_sigmas == pytest.approx(1.0), "of the publication's own sigma"


def test_without_a_reference_or_a_sigma_there_is_no_error() -> None:
    assert StudyValue(1.0, 0.1, "1").percent is None and StudyValue(1.0, 0.1, "1").sigmas is None
    assert StudyValue(1.0, 0.0, "1", true=0.5).sigmas is None and StudyValue(
        1.0, 0.0, "1", true=0.5
    ).percent == pytest.approx(100.0)
    assert StudyValue(1.0, 0.1, "1", true=0.0).percent is None and StudyValue(
        1.0, 0.1, "1", true=0.0
    ).sigmas == pytest.approx(10.0)


def test_another_unit_scales_all_numbers_and_no_error() -> None:
    value = StudyValue(0.2, 0.01, "rad", true=0.21, condensed=0.19, published=(0.18, 0.02))
    other = value.in_unit(10.0, "mrad")
    assert (other.estimate, other.std, other.true, other.condensed) == pytest.approx(
        (2.0, 0.1, 2.1, 1.9)
    )
    assert other.published == pytest.approx((1.8, 0.2)) and other.unit == "mrad"
    assert (other.percent, other.sigmas) == pytest.approx((value.percent, value.sigmas))
    printed = other.published_value
    assert printed is not None and (
        printed.estimate,
        printed.std,
        printed.reference,
    ) == pytest.approx((1.8, 0.2, 1.9))
