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
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in (
        "docs/theory.md", "src/aras_visual_servo_controller/README.md", "docs/reading_results.md")}
    theory, controller, reading = pages.values()
    assert said(GOAL_TOLERANCE) in theory and said(GOAL_TOLERANCE) in controller
    assert said(NEGLIGIBLE_UNCERTAINTY, " degrees") in reading


def test_the_keys_of_a_camera_are_listed_in_one_place():
    listed = "src/aras_sim_bridge/docs/camera.md#settings"
    assert listed in (ROOT / "docs" / "camera.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert "| `effects/" not in page.read_text(encoding="utf-8"), page


def test_the_help_of_every_command_ends_with_an_example():
    files = [*ROOT.glob("src/*/src/**/*.py"), *ROOT.glob("src/*/scripts/*"),
             *ROOT.glob("docs/*.py"), *ROOT.glob("tests/*/*.py")]  # fmt: skip
    found = 0
    for file in files:
        if not file.is_file() or file.suffix not in (".py", "") or file.parent.name == "benchmarks":
            continue
        text = file.read_text(encoding="utf-8")
        for part in text.split("argparse.ArgumentParser(")[1:]:
            if part.startswith((")", "prog=program")):
                continue  # of a type hint; bench's commands have theirs each
            found += 1
            assert "example: " in part.partition(".add_")[0], file
    assert found >= 24
