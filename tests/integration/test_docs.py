"""The first hour's pages on a graph: a user's own scheme, a model, the commands as written."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

from aras_visual_servo_controller.msg import ServoReport
from ros_graph import wait_for

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "docs"))
from blocks import ROOT, Block, blocks  # noqa: E402

ASKS = {"rosservice", "rostopic"}


def page(name: str) -> list[Block]:
    return blocks(ROOT / "docs" / f"{name}.md")


def commands(name: str) -> list[list[str]]:
    return [words for block in page(name) if block.language == "bash" for words in block.commands()]


def arguments(name: str, file: str, folder: Path) -> dict[str, str]:
    """What a page's roslaunch of a file is given."""
    words = next(words for words in commands(name) if file in words)
    given = (word.replace("$PWD", str(folder)).split(":=", 1) for word in words if ":=" in word)
    return dict(given)


def test_the_first_hour_on_a_graph(launch, ros_master, ros_node, collect, tmp_path, monkeypatch):
    for block in (*page("my_scheme"), *page("my_target")):
        if block.file:
            (tmp_path / block.file).write_text(block.text)
    paths = (str(tmp_path), ros_master.environment["PYTHONPATH"])
    monkeypatch.setitem(ros_master.environment, "PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.chdir(tmp_path)
    reports = collect("/aras_visual_servo/controller/diagnosis", ServoReport)
    robot = launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"])
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
        nodes=["/aras_visual_servo_controller"],
        **arguments("my_scheme", "aras_visual_servo_nodes.launch", tmp_path),
    )  # fmt: skip
    try:
        wait_for(
            lambda: reports.messages and reports.messages[-1].phase == "converged", 90.0,
            "a user's scheme to converge",
        )  # fmt: skip
    finally:
        print(*(getattr(reports.messages[-1], key) for key in ("phase", "outcome", "reason"))
              if reports.messages else (nodes.log.read_text()[-2000:],))  # fmt: skip
    asked = [words for name in ("first_run", "my_target") for words in commands(name)]
    asked = [w for w in asked if w[0] in ASKS or "spawn_model" in w]
    assert len(asked) >= 5
    for words in asked:
        said = ros_master.run(words).stdout
        assert "success: False" not in said, f"{shlex.join(words)}: {said}"
    nodes.stop()
    robot.stop()
