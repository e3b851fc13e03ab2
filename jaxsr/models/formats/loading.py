"""An MJCF compiled: as it stands, or with its free base held and without shapes that are absent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.plant import MOST_BYTES, Plant, mujoco, quietly, refuse

FREE = 0  # mjJNT_FREE


def read_plant_file(path: str | Path, *, fixed_base: bool = False) -> tuple[Plant, list[str]]:
    """Compile an MJCF, and return it with what was left out of it.

    Parameters
    ----------
    path : path
    fixed_base : bool
        Whether bodies on free joints stood still in the pose that the file gives them.

    Raises
    ------
    InputError
        The file cannot be read, is no MJCF, or has an element that formulas do not cover.
    """
    path = Path(path)
    library = mujoco()
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError("is too large for a robot", str(path), "Name an MJCF")
        with quietly(library):
            m, said = _compiled(library, path, fixed_base)
    except FileNotFoundError:
        raise InputError("no such file", str(path), "Check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", str(path)) from None
    except ValueError as error:
        what = f"MuJoCo cannot read it: {shortened(str(error), 200)}"
        raise InputError(what, path.name, "Mend the file, or name another") from None
    plant = Plant(path, m)
    refuse(plant)
    return plant, said


def _compiled(library: Any, path: Path, fixed_base: bool) -> tuple[Any, list[str]]:
    """Return MuJoCo's model, and what was left out of the file."""
    try:
        if not fixed_base:
            return library.MjModel.from_xml_path(str(path)), []
        spec = library.MjSpec.from_file(str(path))
        said = _held(spec, path)
        return spec.compile(), said
    except ValueError:
        spec = library.MjSpec.from_file(str(path))
        said = _without_absent_meshes(spec, path)
        if not said:
            raise
        said += _held(spec, path) if fixed_base else []
        return spec.compile(), said


def _held(spec: Any, path: Path) -> list[str]:
    """Take free joints out."""
    free = [joint for joint in spec.joints if int(joint.type) == FREE]
    if not free:
        remedy = "Take fixed_base out of the sidecar"
        raise InputError("has no free joint", path.name, remedy)
    bodies = ", ".join(repr(joint.parent.name) for joint in free)
    for joint in free:
        spec.delete(joint)
    # A key frame has places for the joints that are gone.
    for key in list(spec.keys):
        spec.delete(key)
    return [f"{bodies} is held in the pose of the file, as fixed_base says"]


def _without_absent_meshes(spec: Any, path: Path) -> list[str]:
    """Leave meshes out whose files are not there, where no mass is made of them."""
    folder = path.parent / (spec.meshdir or "")
    missing = [mesh for mesh in spec.meshes if mesh.file and not (folder / mesh.file).is_file()]
    absent = {mesh.name for mesh in missing}
    if not missing:
        return []
    for geom in list(spec.geoms):
        if geom.meshname not in absent:
            continue
        body = geom.parent
        if not body.explicitinertial and (geom.mass or geom.density):
            what = f"mesh {geom.meshname!r}, which body {body.name!r} has its mass of, is absent"
            raise InputError(what, path.name, "Put the file there, or give the body <inertial>")
        spec.delete(geom)
    for mesh in missing:
        spec.delete(mesh)
    names = shortened(", ".join(sorted(absent)), 80)
    return [f"{len(missing)} meshes are absent ({names}): whether they touch is not checked"]
