"""Where what is spawned into a namespace has its topics."""

import pytest

from aras_sim_bridge.ros.gazebo_api.descriptions import in_namespace, parse, root_of

ROBOT = """<robot name="r"><link name="eye"/><gazebo reference="eye"><sensor type="camera" name="c">
<camera><image><width>8</width><height>6</height></image></camera>
<plugin name="p" filename="libgazebo_ros_camera.so">{own}<cameraName>eye</cameraName></plugin>
</sensor></gazebo></robot>"""


@pytest.mark.parametrize(
    ("own", "requested", "namespace"),
    [("", "/left/", "left"), ("", "left", "left"), ("", "/", ""), ("", "", ""),
     ("<robotNamespace>mine</robotNamespace>", "/left", "mine")],
)  # fmt: skip
def test_a_camera_takes_the_requests_namespace_unless_it_has_its_own(own, requested, namespace):
    given = in_namespace(parse(root_of(ROBOT.format(own=own))), requested)
    assert given.cameras[0].plugin.robot_namespace == namespace
