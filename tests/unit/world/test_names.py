"""Names on the graph that two models cannot share are refused before spawning."""

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import (
    UnknownJointError,
    UnknownLinkError,
    UnknownModelError,
)
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import World
from aras_sim_bridge.world.labels import list_links_by_label

INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)
CAMERA = f"""<robot name="c"><link name="base">{INERTIAL}</link>
  <gazebo reference="base"><sensor type="camera" name="{{name}}"><camera><image>
    <width>32</width><height>24</height></image></camera>
    <plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>{{root}}</cameraName>
    <imageTopicName>{{image}}</imageTopicName></plugin></sensor></gazebo></robot>"""


@pytest.fixture
def simulation():
    simulation = Simulation()
    yield simulation
    simulation.close()


def camera(name, root, image="image_raw"):
    return parse_urdf(CAMERA.format(name=name, root=root, image=image))


@pytest.mark.parametrize("root, image, taken", [
    ("eye", "image_raw", "/eye"), ("/eye/", "other", "/eye"),
    # Another root, but the pictures of both would come on one topic.
    ("eye/image_raw", "picture", "/eye/image_raw"), ("", "eye/image_raw", "/eye/image_raw"),
])
def test_two_cameras_of_one_name(simulation, caplog, root, image, taken):
    simulation.spawn(camera("a", "eye"), "first")
    simulation.spawn(camera("b", "else"), "mixed")
    assert len(simulation.cameras) == 2
    simulation.spawn(camera("b", root, image), "second")
    assert len(simulation.cameras) == 2
    (said,) = [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]
    assert said.startswith("model 'second' is simulated without camera 'b': ")
    assert (f"camera 'b' cannot use the ROS name {taken}, because camera 'a' of model 'first' uses "
            "it"
            in said)


def test_unknown_names_carry_what_there_is(make):
    """For programs that want more than the line."""
    with World() as world:
        model = world.spawn(parse_urdf(make.pendulum()), "swing")
        numbers = list_links_by_label(world.models)
        with pytest.raises(UnknownJointError) as joint:
            model.apply_effort("elbow", 1.0)
        with pytest.raises(UnknownLinkError) as link:
            model.link_pose("hand")
        with pytest.raises(UnknownModelError) as other:
            world.model("arm")
    assert (joint.value.model, joint.value.joint, joint.value.available) == (
        "swing", "elbow", ("swing",))
    assert (link.value.link, link.value.available) == ("hand", ("world", "bob"))
    # as Bullet numbers pixels: the body, and above it the link, 0 for the root
    assert numbers == {model.body_id: "swing::world", model.body_id + (1 << 24): "swing::bob"}
    assert (other.value.name, other.value.available) == ("arm", ("swing",))
    assert str(joint.value) == "model 'swing' has no moving joint 'elbow'; its moving joints: swing"
