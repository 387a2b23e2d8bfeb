"""Other spellings of a model file: without meshes, with one link only, with changed tensors or shapes.

Importers read them in addition to the file itself. Names of mesh files become absolute, so that
the text can be stored in any folder.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, Literal, TypeAlias

from lxml import etree

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import number_of
from bodycheck.scenarios.model_files.exact_arithmetic import finite
from bodycheck.scenarios.model_files.mjcf import expanded
from bodycheck.scenarios.model_files.model_file import Format, ModelFile
from bodycheck.scenarios.model_files.sdf import linked, named_models
from bodycheck.scenarios.model_files.urdf import resolved
from bodycheck.scenarios.model_files.xml_file import Node, parse_text, parse_xml

Change: TypeAlias = Literal["tensors changed", "no collision shapes"]
_DIAGONAL = ("ixx", "iyy", "izz")
_FREE = {"type": "free", "damping": "0", "armature": "0", "frictionloss": "0", "stiffness": "0"}
_SECTIONS = ("compiler", "option", "size", "default", "asset", "worldbody", "extension")


def _text(root: Any) -> str:
    return etree.tostring(root, encoding="unicode")


def text_without_meshes(content: bytes, form: Format) -> str:
    """Return a URDF or SDFormat file without the shapes that need mesh files; "" for other formats."""
    if form not in ("urdf", "sdf"):
        return ""
    root = parse_text(content, "model")
    for mesh in list(root.iter("mesh")):
        shape = mesh.getparent().getparent()
        if shape is not None and shape.tag in ("visual", "collision"):
            shape.getparent().remove(shape)
    return _text(root)


def changed_text(model: ModelFile, change: Change) -> str:
    """Return a URDF or SDF with all tensors changed, or without collision shapes; neither has visual ones."""
    root = parse_xml(model.path)
    for link in root.iter("link"):
        for shape in link.findall("visual"):
            link.remove(shape)
    if change == "tensors changed":
        for inertia in root.iter("inertia"):
            for name, value in inertia.attrib.items():
                inertia.set(name, _changed(name, value))
            for part in inertia:  # SDFormat
                part.text = _changed(part.tag, part.text)
    else:
        for link in root.iter("link"):
            for shape in link.findall("collision"):
                link.remove(shape)
    _with_absolute_meshes(root, model.path)
    return _text(root)


def _changed(name: str, value: str | None) -> str | None:
    """Return another number; the text itself if it is none, which the reader has not read either."""
    try:
        return repr(2.0 * number_of(value or "") or float(name in _DIAGONAL))
    except ValueError:
        return value


def excerpt(model: ModelFile, name: str) -> str:
    """Return a model file with one link only, free, with the settings, defaults and meshes of the whole file.

    Raises InputError if the link cannot be used alone.
    """
    if model.format == "urdf":
        root = parse_xml(model.path)
        for child in list(root):
            if child.tag not in ("link", "material") or (child.tag == "link" and child.get("name") != name):
                root.remove(child)
        _with_absolute_meshes(root, model.path)
        return _text(root)
    if model.format == "sdf":
        return _sdf_excerpt(model, name)
    return _mjcf_excerpt(model, name)


def _sdf_excerpt(model: ModelFile, name: str) -> str:
    root = parse_xml(model.path)
    models = named_models(Node(root, model.path))
    link = next(
        node.element for before, one in models for known, node in linked(one, before) if known == name
    )
    for unneeded in (*link.findall("pose"), *link.findall("visual"), *link.findall("sensor")):
        link.remove(unneeded)
    _with_absolute_meshes(link, model.path)
    alone = etree.Element("sdf", version=root.get("version", "1.6"))
    etree.SubElement(alone, "model", name="excerpt").append(link)
    return _text(alone)


def _with_absolute_meshes(root: Any, path: Path) -> None:
    for mesh in root.iter("mesh"):
        if mesh.get("filename"):
            mesh.set("filename", str(resolved(mesh.get("filename"), path).absolute()))
        for uri in mesh.findall("uri"):  # SDFormat
            uri.text = str(resolved((uri.text or "").strip(), path).absolute())


def _mjcf_excerpt(model: ModelFile, name: str) -> str:
    if finite(model.settings.get("settotalmass", "-1"), 1)[0] > 0.0:
        raise InputError("settotalmass scales each body by the masses of all bodies")
    root = expanded(parse_xml(model.path), model.path)
    found = next((body for body in root.iter("body") if body.get("name") == name), None)
    if found is None:
        raise InputError("only named bodies can be used alone")
    above = [one for one in found.iterancestors() if one.tag in ("body", "frame", "replicate")]
    childclass = next((one.get("childclass") for one in (found, *above) if one.get("childclass")), None)
    body = copy.deepcopy(found)
    for unneeded in list(body.iter("body", "joint", "freejoint", "attach", "composite", "flexcomp")):
        if unneeded is not body and unneeded.getparent() is not None:
            unneeded.getparent().remove(unneeded)
    for name_of_other in ("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis", "mocap"):
        body.attrib.pop(name_of_other, None)
    if childclass:
        body.set("childclass", childclass)
    body.insert(0, etree.Element("joint", _FREE))
    for section in list(root):
        if section.tag not in _SECTIONS:
            root.remove(section)
        elif section.tag == "worldbody":
            section.getparent().remove(section)
        elif section.tag == "compiler":
            folder = section.get("meshdir", section.get("assetdir", ""))
            section.set("meshdir", str((model.path.parent / folder).absolute()))
            section.attrib.pop("fusestatic", None)
    if root.find("compiler") is None:
        root.insert(0, etree.Element("compiler", meshdir=str(model.path.parent.absolute())))
    for asset in root.iter("asset"):
        used = {geom.get("mesh") for geom in body.iter("geom")} | {
            geom.get("mesh") for geom in root.iter("geom")
        }
        for mesh in asset.findall("mesh"):
            if (mesh.get("name") or Path(mesh.get("file", "")).stem) not in used:
                asset.remove(mesh)
        for other in ("hfield", "texture", "material", "skin", "model"):
            for one in asset.findall(other):
                asset.remove(one)
    for geom in [*body.iter("geom", "site"), *root.iter("geom", "site")]:
        geom.attrib.pop("material", None)
    world = etree.SubElement(root, "worldbody")
    world.append(body)
    return _text(root)
