"""What the table of free-run errors says in sentences: where only noise is left, and why errors
fall as the horizon grows.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from jaxsr.report.fit_tables import MODELS, UNKNOWN, Role
from jaxsr.report.formatting import is_number, listing, percent, seconds
from jaxsr.report.words import errors_at, headline_index

WITHIN = 1.1
"""Error over that of the sensors' noise up to which nothing more is to be explained: noise is told
to about a tenth, by neighbouring samples."""
FALLS = 0.95
"""Error over that at the next shorter horizon below which it falls: less is scatter."""


def noise_sentence(fit: Mapping[str, Any], about: Mapping[str, Role] = UNKNOWN) -> str:
    """Say where the explained model leaves the sensors' noise alone, at the headline's horizon.

    Nothing is said where it does so on the training recordings and not on those held out.
    """
    within = []
    for words, _, after in errors_at(fit, headline_index(fit)):
        noise = about.get("held_out" if words.startswith("held") else "train", Role()).noise
        if is_number(noise) and is_number(after) and after <= WITHIN * noise:
            within.append((words, percent(after), percent(noise)))
        elif not within:
            return ""
    if not within:
        return ""
    left = [f"the {after} left on {words}" for words, after, _ in within]
    verb = "is" if len(within) == 1 else "are"
    noise = listing(list(dict.fromkeys(floor for _, _, floor in within)))
    said = f"{listing(left)} {verb} the sensors' noise, which alone makes {noise}"
    return f"{said[0].upper()}{said[1:]}: nothing more is to be explained."


def horizon_sentence(fit: Mapping[str, Any]) -> str:
    """Say why errors fall as the horizon grows, where they do, by the largest fall.

    Every horizon's errors are told relative to the same deviation, that of the whole recording;
    what differs is the start of a run.
    """
    horizons = fit.get("horizons_s") or []
    falls = [
        (before / max(after, 1e-300), f"{name.lower()}, {words}", k, before, after)
        for role, words in (("held_out", "held out"), ("train", "training"))
        for model, name in MODELS.items()
        for k, (before, after) in enumerate(pairwise((fit.get(role) or {}).get(model) or []))
        if k + 1 < len(horizons)
        and is_number(before)
        and is_number(after)
        and after < FALLS * before
    ]
    if not falls:
        return ""
    _, row, k, before, after = max(falls, key=lambda fall: fall[0])
    last = k + 2 == len(horizons)
    longer = "whole recordings" if last else f"runs of {seconds(horizons[k + 1])}"
    return (
        f"Some errors fall as the horizon grows ({row}: {percent(before)} over runs of "
        f"{seconds(horizons[k])}, {percent(after)} over {longer}). That is the start's doing: a "
        "run starts from a state estimated on its first 5 % alone, at least 3 readings (50 on a "
        "whole recording). What the noise of a few readings puts into that state, into speeds "
        "above all, is carried through all of a short run. A longer run starts from more readings "
        "and, where the motion is damped, forgets its start."
    )
