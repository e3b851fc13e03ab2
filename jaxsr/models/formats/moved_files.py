"""Edited files of an MJCF for another folder: what they name is found from there."""

from __future__ import annotations

import os
from pathlib import Path

from jaxsr.models.formats.attributes import Attributes
from jaxsr.models.formats.plant import Plant


def edited_files(attributes: Attributes, plant: Plant, folder: Path, name: str) -> dict[str, str]:
    """Return the texts of the edited files by name, the first one called `name`.

    Files that nothing was changed in stay where they are; paths to them are mended if `folder`
    is another one than that of the plant.
    """
    document, home = attributes.document, plant.path.parent
    files: dict[str, str] = {}
    away = folder.resolve() != home.resolve()
    for node in document.includes:
        path = node.attributes.get("file", "")
        inner = next(
            (p for p in (home / path, node.file.parent / path) if p in document.texts), None
        )
        if inner is None:
            continue
        if document.changed(inner):
            document.set(node, {"file": _name_of(inner)})
        elif away:
            document.set(node, {"file": os.path.relpath(inner.resolve(), folder.resolve())})
    if away:
        _mend_assets(attributes, plant, folder)
    for file in document.texts:
        if file == plant.path:
            files[name] = _text(document.edited(file))
        elif document.changed(file):
            files[_name_of(file)] = _text(document.edited(file))
    return files


def _name_of(include: Path) -> str:
    return f"explained_{include.name}"


def _text(data: bytes) -> str:
    return data.decode("utf-8-sig")


def _mend_assets(attributes: Attributes, plant: Plant, folder: Path) -> None:
    """Let folders of meshes and textures be found from another folder."""
    document = attributes.document
    assets = [n for n in document.root.walk() if n.tag in ("mesh", "texture", "hfield", "skin")]
    if not any("file" in node.attributes for node in assets):
        return
    home = os.path.relpath(plant.path.parent.resolve(), folder.resolve())
    compilers = attributes.elements.compilers
    keys = ("meshdir", "texturedir", "assetdir")
    told = [(c, k) for c in compilers for k in keys if k in c.attributes]
    for compiler, key in told:
        old = compiler.attributes[key]
        if not os.path.isabs(old):
            document.set(compiler, {key: os.path.join(home, old)})
    if told:
        return
    if compilers:
        document.set(compilers[0], {"assetdir": home})
        return
    for node in assets:
        name = node.attributes.get("file", "")
        if name and not os.path.isabs(name):
            document.set(node, {"file": os.path.join(home, name)})
