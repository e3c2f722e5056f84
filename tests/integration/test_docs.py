"""Documentation pages on a graph: a user's scheme, a model, and commands as printed."""

import os
import shlex
import sys
from pathlib import Path

from aras_visual_servo_controller.msg import ServoReport
from gazebo_calls import time_goes_on

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "docs"))
from blocks import ROOT, Block, blocks  # noqa: E402

ASKS = {"rosservice", "rostopic"}


def page(name: str) -> list[Block]:
    return blocks(ROOT / "docs" / f"{name}.md")


def commands(*names: str) -> list[list[str]]:
    return [words for name in names for block in page(name) if block.language == "bash"
            for words in block.commands()]


def arguments(name: str, file: str, folder: Path) -> dict[str, str]:
    """Return the arguments that a page passes to roslaunch for a file."""
    words = next(words for words in commands(name) if file in words)
    return dict(word.replace("$PWD", str(folder)).split(":=", 1) for word in words if ":=" in word)


def test_the_first_hour_on_a_graph(launch, ros_node, ros_master, collect, tmp_path, monkeypatch):
    """The whole machine; nodes find what a user has written."""
    path = f"{tmp_path}{os.pathsep}{ros_master.environment['PYTHONPATH']}"
    monkeypatch.setitem(ros_master.environment, "PYTHONPATH", path)
    monkeypatch.chdir(tmp_path)
    launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], paused=True)
    for block in (*page("my_scheme"), *page("my_target")):
        if block.file:
            (tmp_path / block.file).write_text(block.text)
    reports = collect("/aras_visual_servo/controller/diagnosis", ServoReport)
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                   nodes=["/aras_visual_servo_controller"],
                   **arguments("my_scheme", "aras_visual_servo_nodes.launch", tmp_path))
    with time_goes_on():
        try:
            reports.wait(timeout=90.0, where=lambda report: report.phase == "converged")
        finally:
            print(reports.messages[-1:], nodes.output()[-2000:])
        asked = [words for words in commands("first_run", "my_target")
                 if words[0] in ASKS or "spawn_model" in words]
        assert len(asked) >= 5
        for words in asked:
            said = ros_master.run(words).stdout
            assert "success: False" not in said, f"{shlex.join(words)}: {said}"
