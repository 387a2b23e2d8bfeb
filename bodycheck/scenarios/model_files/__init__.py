"""Read the bodies that URDF, MJCF, SDFormat and USD files state, in 40-digit arithmetic without engines."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from bodycheck._util.errors import InputError

if TYPE_CHECKING:
    from bodycheck.scenarios.model_files.model_file import ModelFile


def read_model(path: Path) -> ModelFile:
    """Return what a model file states; its suffix selects USD, and its root element the other formats.

    Raises InputError with one line: the file, the line in it, what is wrong and what would be right.
    """
    # importing lxml and mpmath takes time, and few commands read model files
    from bodycheck.scenarios.model_files.mjcf import read_mjcf
    from bodycheck.scenarios.model_files.sdf import read_sdf
    from bodycheck.scenarios.model_files.urdf import read_urdf
    from bodycheck.scenarios.model_files.usd import USD_SUFFIXES, read_usd
    from bodycheck.scenarios.model_files.xml_file import Node, parse_xml

    if path.suffix.lower() in USD_SUFFIXES:
        return read_usd(path)
    root = parse_xml(path)
    _refuse_macros(root, path)
    match Node(root, path).tag:
        case "robot":
            return read_urdf(root, path)
        case "mujoco":
            return read_mjcf(root, path)
        case "sdf":
            return read_sdf(root, path)
        case "gazebo":
            raise InputError(
                f"{path}:{root.sourceline}: <gazebo>: is SDFormat before 1.2, which is not read "
                f"(expected the result of: gz sdf -p {quote(str(path))})"
            )
        case tag:
            raise InputError(
                f"{path}:{root.sourceline}: <{tag}>: is not a model (expected <robot>, <mujoco> or <sdf>)"
            )


def _refuse_macros(root: Any, path: Path) -> None:
    """Raise InputError for a file with macros of xacro, which would evaluate Python of the file.

    Definitions of numbers that nothing uses are no macros: engines skip them.
    """
    for element in root.iter():
        namespace, _, name = str(element.tag).rpartition("}")
        of_xacro = namespace.endswith("/xacro") or name.startswith("xacro:")
        if of_xacro and name.removeprefix("xacro:") in ("arg", "property"):
            continue
        if of_xacro or any("${" in value for value in (element.text or "", *element.values())):
            expanded = path.with_name(f"{path.stem}_expanded{path.suffix}")
            if path.suffix == ".xacro":
                expanded = path.with_suffix("" if "." in path.stem else ".urdf")
            raise InputError(
                f"{path}:{element.sourceline}: xacro macros are not expanded here "
                f"(expected the result of: xacro {quote(str(path))} > {quote(str(expanded))})"
            )
