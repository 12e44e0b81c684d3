"""Estimators, each a function of a model and a record: ``fid.estimators.output_error(...)``."""

from __future__ import annotations

from scenarios.api.estimators import (
    ekf,
    equation_error,
    filter_error,
    output_error,
    smoother,
    ukf,
)

__all__ = ["ekf", "equation_error", "filter_error", "output_error", "smoother", "ukf"]


def __dir__() -> list[str]:
    return __all__
