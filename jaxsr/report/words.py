"""Verdicts, mechanisms and sites in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxsr._result import Verdict
from jaxsr.report.formatting import (
    estimate,
    in_ascii,
    is_number,
    listing,
    number,
    sureness,
    unit_text,
)

VERDICT_TITLES = {
    Verdict.NOTHING: "Nothing is missing",
    Verdict.PARAMETER: "A parameter is wrong",
    Verdict.STRUCTURE: "Physics is missing",
    Verdict.MEASUREMENT: "The measurement is at fault",
    Verdict.EXTERNAL_INPUT: "Something unrecorded acted",
    Verdict.UNDECIDED: "The cause is undecided",
}

_MECHANISMS = {
    "wrong_value": "wrong value",
    "viscous_damping": "viscous damping",
    "coulomb_friction": "Coulomb friction",
    "asymmetric_friction": "friction that depends on the direction",
    "stribeck_friction": "Stribeck friction",
    "position_dependent_friction": "friction that depends on the position",
    "load_dependent_friction": "friction that grows with the load",
    "coupled_friction": "friction on two speeds together",
    "quadratic_drag": "quadratic drag",
    "power_law_drag": "power-law drag",
    "linear_stiffness": "a linear spring",
    "quadratic_stiffness": "quadratic stiffness",
    "cubic_stiffness": "cubic stiffness",
    "piecewise_stiffness": "a spring that engages past a point",
    "end_stop": "an end stop",
    "backlash": "backlash",
    "added_mass": "added mass or inertia",
    "gravity": "gravity",
    "constant_force": "a constant force",
    "centrifugal_coupling": "centrifugal coupling",
    "coupling_stiffness": "a spring between coordinates",
    "coupling_damping": "a damper between coordinates",
    "harmonic_force": "a harmonic force",
    "position_ripple": "a ripple over the position",
    "parametric_excitation": "a stiffness that varies in time",
    "hysteresis": "hysteresis",
    "actuator_lag": "a lag of the actuator",
    "hidden_mode": "an unmodelled resonance",
    "drift": "a slow drift",
    "overflow": "overflow",
    "input_saturation": "saturation of the input",
    "input_deadzone": "a dead zone of the input",
    "input_curve": "a gain of the input that depends on its size",
    "input_gain_by_state": "a gain of the input that depends on a state",
    "input_gain": "wrong gain of the input",
    "input_delay": "a delay of the input",
    "sensor_gain": "wrong gain of the sensor",
    "sensor_bias": "an offset of the sensor",
    "sensor_delay": "a delay of the sensor",
    "clipping": "clipping of the sensor",
    "rectified": "a sensor without a sign",
    "quantisation": "quantisation of the sensor",
    "clock_skew": "a clock that runs wrong",
    "transient_force": "a transient force",
    "unnamed": "an effect without a name",
}

_SITES = {
    "equation": "equation of {}",
    "input": "input {}",
    "output": "sensor {}",
    "parameter": "parameter {}",
    "external": "force on {}",
}


def mechanism_words(mechanism: object) -> str:
    """Return a mechanism in plain words; an unknown name without its underscores."""
    name = str(mechanism)
    return _MECHANISMS.get(name, name.replace("_", " "))


def site_words(site: object) -> str:
    """Return a site in plain words, ``equation:v`` as "equation of v"."""
    kind, _, name = str(site or "").partition(":")
    return _SITES[kind].format(name) if kind in _SITES and name else str(site or "")


def mechanism_at(text: str) -> str:
    """Return ``coulomb_friction@equation:v`` in plain words."""
    mechanism, _, site = text.partition("@")
    words = mechanism_words(mechanism)
    if not site:
        return words
    return _of_signal(words, site) or f"{words}, {site_words(site)}"


def _of_signal(words: str, site: str) -> str | None:
    """Put a signal's name in its place: "a delay of the sensor", ``output:y`` to "... of sensor y".

    None where the words name no signal.
    """
    head, _, kind = words.rpartition(" of the ")
    return f"{head} of {site_words(site)}" if head and kind in ("sensor", "input") else None


def capital(text: str) -> str:
    """Raise the first letter; the rest stays."""
    return text[:1].upper() + text[1:]


def verdict_title(verdict: object) -> str:
    """Return the verdict in a few words."""
    return VERDICT_TITLES.get(Verdict(str(verdict)), str(verdict))


def verdict_sentence(document: Mapping[str, Any]) -> str:
    """Return the verdict in a sentence: what is wrong, and where.

    It is the one that the terminal, the report and Python show, in ASCII but for names of the
    user's: some terminals print no more.
    """
    verdict = Verdict(str(document.get("verdict")))
    names = list(dict.fromkeys(_place(finding) for finding in document.get("findings") or []))
    if verdict == Verdict.NOTHING:
        return "The model agrees with the recordings: no mismatch stands above the noise."
    if verdict == Verdict.UNDECIDED:
        ended = "The search did not come to an answer."
        mismatch = "A mismatch is there, but these recordings cannot tell its cause."
        leading = listing(names, last="or")
        if left_open(document):
            return f"{ended} Leading among what was compared: {leading}." if names else ended
        return f"{mismatch} Leading: {leading}." if names else mismatch
    opening = {
        Verdict.PARAMETER: "The structure is right, a value is not: {}",
        Verdict.STRUCTURE: "The model leaves out {}",
        Verdict.MEASUREMENT: "The physics is right, the measurement is not: {}",
        Verdict.EXTERNAL_INPUT: "Something acted that no column records: {}",
    }[verdict]
    return f"{opening.format(listing(names) or 'a cause without a name')}."


def whole_sentence(document: Mapping[str, Any]) -> str:
    """Return `verdict_sentence`, and in another sentence what was left open."""
    return f"{verdict_sentence(document)} {left_open(document)}".strip()


def figures_of(finding: Mapping[str, Any]) -> str:
    """Return what a finding weighs in a line: its constants with intervals and units, how sure."""
    parts = []
    for name, row in (finding.get("parameters") or {}).items():
        value, interval = estimate(row.get("value"), row.get("ci95"))
        unit = unit_text(row.get("unit"))
        shown = f"{name} = {value}{' ' + unit if unit else ''}"
        parts.append(f"{shown} ({interval})" if row.get("ci95") else shown)
    if is_number(finding.get("probability")):
        parts.append(f"{sureness(finding.get('probability'))} probable")
    return ", ".join(parts)


def left_open(document: Mapping[str, Any]) -> str:
    """Return who or what ended the search and what it did not try; empty where it tried all."""
    provenance = document.get("provenance") or {}
    return str((provenance.get("open") or {}).get("message") or "")


def _place(finding: Mapping[str, Any]) -> str:
    site = str(finding.get("site") or "")
    if finding.get("mechanism") == "wrong_value":
        return _wrong_value(finding, site.partition(":")[2])
    words = mechanism_words(finding.get("mechanism"))
    signal = _of_signal(words, site)
    if signal is not None:
        return signal
    joint = "as a" if site.startswith("external:") else "in the"
    return f"{words} {joint} {site_words(site)}" if site else words


def _wrong_value(finding: Mapping[str, Any], name: str) -> str:
    fitted = (finding.get("parameters") or {}).get(name) or {}
    if not fitted:
        return f"the value of {name}"
    value, interval = estimate(fitted.get("value"), fitted.get("ci95"))
    unit = str(fitted.get("unit") or "")
    shown = f"{name} is {in_ascii(value)}{f' {unit}' if unit not in ('', '1') else ''}"
    return f"{shown} ({in_ascii(interval)})" if fitted.get("ci95") else shown


def errors_at(
    fit: Mapping[str, Any] | None, index: int | None
) -> list[tuple[str, float | None, float | None]]:
    """Return (recordings, re-calibrated, explained) at one of the horizons, held-out first."""
    if fit is None or index is None:
        return []
    pairs = []
    for key, words in (("held_out", "held-out recordings"), ("train", "training recordings")):
        rows = fit.get(key) or {}
        before, after = (_entry(rows.get(name), index) for name in ("recalibrated", "explained"))
        if before is not None or after is not None:
            pairs.append((words, before, after))
    return pairs


def headline_index(fit: Mapping[str, Any] | None) -> int | None:
    """Return the position of the headline horizon among the horizons."""
    horizons = (fit or {}).get("horizons_s") or []
    wanted = (fit or {}).get("headline_s")
    return horizons.index(wanted) if wanted in horizons else None


def _entry(values: Any, index: int) -> float | None:
    return values[index] if values and index < len(values) else None


def region_words(rows: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> list[str]:
    """Return a region of ``where`` in words, one text for each variable.

    Parameters
    ----------
    rows : sequence of mapping
        Ranges; those of one variable are alternatives.
    units : mapping
        Variable to its printed unit.
    """
    texts: dict[str, list[str]] = {}
    for row in rows:
        name = str(row.get("variable", "?"))
        texts.setdefault(name, []).append(_range_words(row, units.get(name, "")))
    return [" and ".join(found) for found in texts.values()]


def _range_words(region: Mapping[str, Any], unit: str) -> str:
    """Return one range as an inequality, or say that it is all there was."""
    low, high = (_bound(region.get(end)) for end in ("from", "to"))
    name = str(region.get("variable", "?"))
    tail = f" {unit}" if unit else ""
    if region.get("everywhere"):
        return f"at every {name} recorded ({low} to {high}{tail})"
    if low and high:
        return f"{low} < {name} < {high}{tail}"
    if low or high:
        return f"{name} > {low}{tail}" if low else f"{name} < {high}{tail}"
    return f"all {name}"


def _bound(value: object) -> str:
    return number(value, 3) if is_number(value) else ""
