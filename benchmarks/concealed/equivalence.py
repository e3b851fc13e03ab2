"""Which answers count as one: the table, written out.

After docs/mechanisms.md. An answer is right if its mechanism and site are those planted, or
stand with them in a row below under the row's condition.

| planted | also right | where |
|---|---|---|
| constant_force, gravity (straight axis) | each other | same equation |
| constant_force, gravity (straight axis) | sensor_bias | any position sensor; springs |
| sensor_bias | constant_force, gravity | any equation, where a spring exists |
| drift | constant_force, transient_force | never: another mechanism |
| added_mass, viscous_damping, linear_stiffness, gravity, ... | wrong_value | that constant (twin) |
| input_delay | sensor_delay | any output, one sensor |
| sensor_delay | input_delay | any input, one sensor |
| input_gain | wrong_value | any constant: a common factor |
| sensor_gain | input_gain, wrong_value | one sensor: a common factor |
| piecewise_stiffness, end_stop | each other | same equation |
| stribeck with n = 1 or 2 | each other | same equation |
| transient_force | the same | external or equation of the same state |
| two-sided effects | the same | any equation on which the effect acts |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.concealed.effects import FAMILY, verdict_of

PAIRS = (
    frozenset({"constant_force", "gravity"}),
    frozenset({"piecewise_stiffness", "end_stop"}),
)
CONSTANT = frozenset({"constant_force", "gravity"})


def same_site(site: str, effect: Mapping[str, Any]) -> bool:
    """Whether a site is one at which the effect acts."""
    own = {effect["site"], *effect["sites"]}
    if effect["mechanism"] == "transient_force":
        own |= {s.replace("external:", "equation:") for s in own}
    return site in own


def equivalent(
    mechanism: str, site: str, effect: Mapping[str, Any], case: Mapping[str, Any]
) -> bool:
    """Whether an answer names a planted effect, equivalent causes counted as one.

    Parameters
    ----------
    mechanism, site : str
        Of the answer.
    effect, case : mappings
        Entries of the truth.
    """
    planted = effect["mechanism"]
    turning = effect["site"].split(":")[-1] in case["turning"]
    if mechanism == planted:
        return same_site(site, effect)
    if {mechanism, planted} in PAIRS and not (turning and "gravity" in (mechanism, planted)):
        return same_site(site, effect)
    single = len(case["sensors"]) == 1
    if mechanism == "wrong_value":
        if site.removeprefix("parameter:") in effect["twins"]:
            return True
        return planted == "input_gain" or (planted == "sensor_gain" and single)
    if planted in CONSTANT and not turning and mechanism == "sensor_bias":
        return bool(case["springs"]) and site.startswith("output:")
    if planted == "sensor_bias" and mechanism in CONSTANT:
        return bool(case["springs"]) and site.startswith("equation:")
    if {mechanism, planted} == {"input_delay", "sensor_delay"}:
        return single
    return planted == "sensor_gain" and mechanism == "input_gain" and single


def right_verdicts(case: Mapping[str, Any]) -> frozenset[str]:
    """Return the verdicts that are right for a case.

    Without an effect: nothing. Below detectability: nothing or undecided, and parameter where
    calibration absorbs the effect by moving the given values. Else the verdict of a planted
    effect or of an equivalent cause; undecided as well where the experiments were made so
    that they cannot tell (collinear), no name fits (unnamed), or where the likelihood of another
    wrong scale equals that of the planted one.
    """
    if not case["effects"]:
        return frozenset({"nothing"})
    evidence = case["evidence"]
    if not evidence["detectable"]:
        more = {"parameter"} if evidence["absorbed"] else set()
        return frozenset({"nothing", "undecided", *more})
    right = set()
    for effect in case["effects"]:
        right.add(effect["verdict"])
        for mechanism in FAMILY:
            sites = (
                *(f"parameter:{t}" for t in effect["twins"]),
                effect["site"],
                "parameter:any",
                "output:any",
                "input:any",
                "equation:any",
            )
            if any(equivalent(mechanism, s, effect, case) for s in sites):
                right.add(verdict_of(mechanism))
    if case["kind"] in ("collinear", "unnamed") or evidence.get("indistinct"):
        right.add("undecided")
    return frozenset(right)
