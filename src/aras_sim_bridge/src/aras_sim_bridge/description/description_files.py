"""Reader of files that describe a robot or another model."""

from __future__ import annotations

from pathlib import Path

from aras_sim_bridge.description import RobotDescription, parse_sdf, parse_urdf
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml


def load_description(path: str | Path) -> RobotDescription:
    """Read a description of a robot or another model for `Simulation.spawn`.

    Args:
        path: URDF file with xacro already expanded, or SDF file with one model. Relative mesh paths
            are relative to the folder of the file; `package://` and `model://` are resolved.

    Returns:
        The checked description. Its `warnings` contain one sentence for each part that is not
        simulated.

    Raises:
        DescriptionError: the file cannot be read, or it contains something that cannot be
            simulated; the message names the file and the element.
    """
    where = f"description {path}"
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{where} cannot be read: {error}") from None
    root = safe_xml.parse(text, where)
    folder = str(Path(path).resolve().parent)
    try:
        if root.tag == "robot":
            return parse_urdf(root, base_directory=folder)
        if root.tag in ("sdf", "gazebo"):
            return parse_sdf(root, folder)
    except DescriptionError as error:
        raise DescriptionError(f"{where}: {error}") from None
    raise DescriptionError(
        f"{where}: the root element is <{safe_xml.shorten(root.tag)}>; it must be <robot> (URDF) "
        "or <sdf>"
    )
