"""The services of a world's link attacher."""

import pytest
from gazebo_ros_link_attacher.srv import Attach

from aras_sim_bridge.description import parse_urdf, world_file
from aras_sim_bridge.ros.gazebo_api import attacher
from aras_sim_bridge.ros.runtime.services import ServiceTable, find_handlers
from aras_sim_bridge.world import Pose

THING = """<robot name="t"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1"
    izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def test_links_are_attached_and_let_go(graph, thread):
    ServiceTable(attacher.NAMESPACE, thread, *find_handlers(attacher))
    for k in (1, 2):
        thread.call(lambda k=k: thread.simulation.spawn(parse_urdf(THING), f"m{k}",
                                                        Pose((float(k), 0.0, 1.0))))

    def ask(service, *names):
        assert graph.types[f"/link_attacher_node/{service}"] is Attach
        return graph.call(f"/link_attacher_node/{service}", *names).ok

    pair = ("m1", "a", "m2", "a")
    assert not ask("detach", *pair)
    assert "are not attached" in graph.lines[-1]
    assert ask("attach", *pair)
    assert ask("attach", *pair)
    assert not ask("attach", "m1", "b", "m2", "a")
    assert "'b'" in graph.lines[-1]
    assert ask("detach", *pair)
    assert not ask("detach", *pair)


@pytest.mark.parametrize("plugin", [True, False])
def test_a_world_says_whether_it_has_the_plug_in(tmp_path, plugin):
    file = tmp_path / "a.world"
    inside = "<plugin name='p' filename='libgazebo_ros_link_attacher.so'/>" * plugin
    file.write_text(f"<sdf version='1.6'><world name='w'>{inside}</world></sdf>")
    read = world_file.load_world(str(file))
    assert read.link_attacher is plugin and not read.warnings
