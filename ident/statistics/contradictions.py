"""Whether an estimated derivative can be believed beside the value that was declared of it."""

from __future__ import annotations

import math

SIGMAS = 2.0  # to either side: what an estimate may be by its own account
THREEFOLD = 3.0  # a vehicle file is possibly 30 % wrong: ten of its sigmas from zero, as far as from a turned sign


def contradiction(value: float, std: float, declared: float) -> str:
    """What speaks against an estimate with its sigma where another value was declared; empty where nothing does.

    An estimate contradicts where no value within two sigmas has the declared sign and less than three times the declared size. Nothing speaks where
    zero was declared, or where value or sigma are not finite: that tells of no derivative.
    """
    if declared == 0.0 or not (math.isfinite(value) and math.isfinite(std) and std >= 0.0):
        return ""
    share, sigma = value / declared, abs(std / declared)
    if share + SIGMAS * sigma < 0.0:
        return "has the other sign"
    if share - SIGMAS * sigma > THREEFOLD:
        return f"is {share:.2g} times as large"
    return ""


def shortfall(value: float, std: float, declared: float) -> str:
    """By how much an estimate falls short of a declared value: ``"is 12 times smaller"``; empty where it does not.

    It falls short where no value within two sigmas reaches a third of the declared size: a constant of the vehicle file that is too large,
    such as its chord, makes derivatives too small by the same factor. A value of the other sign is for ``contradiction``.
    """
    if declared == 0.0 or not (math.isfinite(value) and math.isfinite(std) and std >= 0.0):
        return ""
    share, sigma = value / declared, abs(std / declared)
    if abs(share) + SIGMAS * sigma >= 1.0 / THREEFOLD or share + SIGMAS * sigma < 0.0:
        return ""
    return f"is {1.0 / share:.2g} times smaller" if share > SIGMAS * sigma else "is not told from zero"
