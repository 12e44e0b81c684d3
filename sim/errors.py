"""The errors that a user can mend: what is wrong, where, and what to do about it."""

from __future__ import annotations


class FlightidError(Exception):
    """A wrong declaration or bad input, in one line.

    Parameters
    ----------
    what : what is wrong, e.g. ``"unit 'kg' does not measure an angle"``.
    where : the file and the row, key, column or object it was found in.
    remedy : what the user should write or do instead.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        line = f"{where}: {what}" if where else what
        super().__init__(f"{line}; {remedy}" if remedy else line)


class RecordError(FlightidError):
    """A record that cannot be used as it stands."""


class ModelError(FlightidError):
    """A model, effect or parameter that is declared wrongly, or used where it cannot serve."""


class DeclarationError(FlightidError):
    """A vehicle, scenario or channel-map file that is wrong."""
