"""Package upstream_msgs in a running system: generated modules, tools, messages on the graph."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path

MD5_LIST = Path(__file__).parents[1] / "upstream_md5.txt"
TALKER = """<launch>
  <arg name="height" default="1.0" />
  <node name="talker" pkg="rostopic" type="rostopic" args="pub -r 20 link gazebo_msgs/LinkState
    '{link_name: tip, pose: {position: {z: $(arg height)}}, reference_frame: world}'" ns="arm" />
</launch>"""


def expected() -> list[tuple[str, str]]:
    lines = MD5_LIST.read_text().splitlines()
    return [tuple(line.split()) for line in lines if not line.startswith("#")]


def test_generated_modules_have_upstreams_md5() -> None:
    wrong = {}
    for name, md5 in expected():
        package, short = name.split("/")
        kinds = [kind for kind in ("msg", "srv") if importlib.util.find_spec(f"{package}.{kind}")]
        modules = [importlib.import_module(f"{package}.{kind}") for kind in kinds]
        (found,) = (getattr(module, short) for module in modules if hasattr(module, short))
        if found._md5sum != md5:
            wrong[name] = found._md5sum
    assert not wrong


def test_private_graph_starts_and_ends_without_a_trace(launch, ros_master, tmp_path) -> None:
    (tmp_path / "talker.launch").write_text(TALKER)
    launched = launch(str(tmp_path / "talker.launch"), own_master=True)
    echo = launched.master.run(["rostopic", "echo", "-n1", "/arm/link/link_name"])
    assert echo.stdout.splitlines()[0].strip('"') == "tip"
    assert launched.master.uri != ros_master.uri
    launched.stop()
    assert launched.master.nodes() == set()
