"""A Functional Mock-up Unit by FMPy, in the worker's process; never imported by the package."""

from __future__ import annotations

import os
import re
import zipfile
from typing import Any

from fmi_unit import Refused


def opened(request: dict[str, Any]) -> Any:
    """Open an FMU, its model exchange where it has one."""
    path, folder = request["path"], request["folder"]
    try:
        import fmpy
        from fmpy import model_description
    except ImportError:
        raise Refused("FMPy is not installed", "Install jaxsr-dynamics[fmu]") from None
    if not zipfile.is_zipfile(path):
        raise Refused("is no FMU: not a ZIP archive", "Export it again")
    version = _version(path)
    if version and not version.startswith(("2.", "3.")):
        raise Refused(f"is FMI {version}", "Export it as FMI 2 or 3")
    try:
        about = model_description.read_model_description(path, validate=False)
    except Exception as error:
        what = " ".join(str(error).split())[:80]
        raise Refused(f"has no readable modelDescription.xml: {what}", "Export it again") from None
    own = about.modelExchange or about.coSimulation
    if own is None or own.modelIdentifier is None:
        raise Refused("has neither model exchange nor co-simulation", "Export one of them")
    fmpy.extract(path, unzipdir=folder)
    platform = fmpy.platform if about.fmiMajorVersion == 2 else fmpy.platform_tuple
    name = own.modelIdentifier + fmpy.sharedLibraryExtension
    if not os.path.isfile(os.path.join(folder, "binaries", platform, name)):
        inside = os.path.join(folder, "binaries")
        there = sorted(os.listdir(inside)) if os.path.isdir(inside) else []
        raise Refused(
            f"holds no binary for {platform} ({', '.join(there) or 'none at all'})"[:140],
            "Export it for this system, or compile it",
        )
    from fmi_exchange import Exchange
    from fmi_steps import Stepped

    if about.modelExchange is not None:
        return Exchange(about, folder)
    return Stepped(about, folder, request.get("step"))


def _version(path: str) -> str:
    """Return the version of FMI that a description states; empty where it states none."""
    try:
        with zipfile.ZipFile(path) as archive:
            text = archive.read("modelDescription.xml")
    except (KeyError, OSError, zipfile.BadZipFile):
        return ""
    found = re.search(rb"fmiVersion\s*=\s*[\"']([0-9][^\"']{0,20})[\"']", text[:10_000])
    return found[1].decode("ascii", "replace") if found else ""
