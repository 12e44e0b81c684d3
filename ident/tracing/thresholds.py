"""Levels of significance, resolutions and budgets of the tracing loop outside its evidence.

Priors stand in ``evidence/priors.py``, levels of the verdict in ``evidence/decision.py``, what a
caller may set in ``settings.py``.
"""

from __future__ import annotations

# Is a residual noise?
COLOURED = 1e-3  # p-value of a residual test below which a residual is looked at once more
FEWEST_SAMPLES = 20  # with fewer the test has four lags at most, and little power
LOW_FREQUENCY = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below

NEAR_EVENT = 0.15  # s around the edge of a fitted event, where its form may be a little off

# How finely is it computed?
SLOPE_STEP = 1e-4  # of a parameter's declared size
COARSE = 0.025  # s, a sub-step that ranks candidates well enough
PLACES = 60  # over the record, for effects that may begin anywhere
SHARP_PLACES = 2000  # over the record, for a step of one output
