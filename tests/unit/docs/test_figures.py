"""Numbers that several pages state are equal to those of the code."""

import math

from blocks import ROOT

from aras_visual_servo_controller.diagnosis.camera_offset import GOAL_TOLERANCE
from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY


def said(part_and_radians, degrees="°"):
    """Return the text of a bound: fraction of the depth, and angle (rad)."""
    part, angle = part_and_radians
    depth = f"{100 * part:g} % of the target's depth ({1e3 * part * 0.2:g} mm at 0.2 m)"
    return f"within {depth} and {math.degrees(angle):.1f}{degrees}"


def test_pages_tell_alike_when_a_loop_has_arrived_and_what_it_leaves_open():
    """And list the keys of a camera in one place."""
    theory, controller, reading, camera = ((ROOT / name).read_text(encoding="utf-8") for name in (
        "docs/theory.md", "src/aras_visual_servo_controller/README.md", "docs/reading_results.md",
        "docs/camera.md"))  # fmt: skip
    assert said(GOAL_TOLERANCE) in theory and said(GOAL_TOLERANCE) in controller
    assert said(NEGLIGIBLE_UNCERTAINTY, " degrees") in reading
    assert "src/aras_sim_bridge/docs/camera.md#settings" in camera
    for page in (ROOT / "docs").glob("*.md"):
        assert "| `effects/" not in page.read_text(encoding="utf-8"), page
