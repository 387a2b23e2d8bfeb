"""Read the bodies that URDF, MJCF and SDFormat files state, in 40-digit arithmetic and without any engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bodycheck._util.errors import InputError

if TYPE_CHECKING:
    from bodycheck.scenarios.model_files.model_file import ModelFile


def read_model(path: Path) -> ModelFile:
    """Return what a URDF, MJCF or SDFormat file states; its root element selects the format.

    Raises InputError with one line: the file, the line in it, what is wrong and what would be right.
    """
    # importing lxml and mpmath takes time, and few commands read model files
    from bodycheck.scenarios.model_files.mjcf import read_mjcf
    from bodycheck.scenarios.model_files.sdf import read_sdf
    from bodycheck.scenarios.model_files.urdf import read_urdf
    from bodycheck.scenarios.model_files.xml_file import Node, parse_xml

    root = parse_xml(path)
    match Node(root, path).tag:
        case "robot":
            return read_urdf(root, path)
        case "mujoco":
            return read_mjcf(root, path)
        case "sdf":
            return read_sdf(root, path)
        case tag:
            raise InputError(
                f"{path}:{root.sourceline}: <{tag}>: is not a model (expected <robot>, <mujoco> or <sdf>)"
            )
