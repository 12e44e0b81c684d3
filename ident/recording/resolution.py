"""The least bit of a channel against its noise."""

from __future__ import annotations

from ident.recording.finding import Certainty, Finding, Kind, Number, shown
from ident.recording.series import Series

COARSE = 1.0  # least bits over noise: below it rounding adds a twelfth of the noise's variance at most
DISTINCT = 4  # levels, fewer of which make no measurement


def coarse(series: Series) -> Finding | None:
    """A note where the least bit is coarse against the noise, so that residuals are rounding and not Gaussian."""
    bit = series.least_bit
    if not bit or series.span < DISTINCT * bit or bit < COARSE * series.noise:
        return None
    told = f"has a least bit of {shown(bit, series.unit)}, coarse against its noise: smaller things are not in the record, and rounding is not white"
    numbers = {"least_bit": Number(bit, series.unit)} | ({"noise": Number(series.noise, series.unit)} if series.noise else {})
    return Finding(series.name, Kind.RESOLUTION, Certainty.NOTED, told, "", (), numbers)
