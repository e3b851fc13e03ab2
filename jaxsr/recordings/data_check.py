"""A finding about the data of a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DataCheck:
    """A finding about the data of one file.

    Attributes
    ----------
    file : str
    channel : str
        Column, "time", or "file" where it is about the file as a whole.
    check : str
        One of ``reading``, ``time_unit``, ``wrap``, ``non_uniform_time``, ``gap``,
        ``missing_samples``, ``constant``, ``clipping``, ``quantisation``, ``noise``,
        ``outliers``, ``lag``, ``masked``.
    message : str
        A plain sentence.
    value : float or None
        The number the message is about, in the channel's unit or in seconds.
    """

    file: str
    channel: str
    check: str
    message: str
    value: float | None = None
