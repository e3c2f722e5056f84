"""Topics of a model that is spawned into a namespace."""

from xml.etree import ElementTree

import pytest

from aras_sim_bridge.description import CameraPlugin
from aras_sim_bridge.description.plugins import PLUGINS
from aras_sim_bridge.ros.gazebo_api.spawn_requests import set_namespace
from aras_visual_servo_base.safe_xml import ElementReader

WITHOUT_TOPICS = {"gazebo_grasp_fix", "gazebo_ros_link_attacher"}  # of the model's own


@pytest.mark.parametrize("file", sorted(PLUGINS.keys() - WITHOUT_TOPICS))
@pytest.mark.parametrize(("own", "requested", "namespace"), [
    ("", "/left/", "left"), ("", "left", "left"), ("", "/", ""),
    ("<robotNamespace>mine</robotNamespace>", "/left", "mine"), ("<robotNamespace/>", "left", "")])
def test_every_plugin_takes_the_requested_namespace_unless_it_names_one(
    file, own, requested, namespace
):
    root = ElementTree.fromstring(
        f"<robot><gazebo><plugin filename='lib{file}.so'>{own}</plugin></gazebo></robot>")
    set_namespace(root, requested)
    made = PLUGINS[file](ElementReader(root.find("gazebo/plugin"), "test: "))
    found = made.namespace if hasattr(made, "namespace") else made.robot_namespace
    assert found is not None and found.strip("/") == namespace


def test_without_a_request_each_plugin_keeps_its_default():
    root = ElementTree.fromstring("<robot><plugin filename='libgazebo_ros_camera.so'/></robot>")
    set_namespace(root, "")
    plugin = ElementReader(root.find("plugin"), "test: ")
    assert PLUGINS["gazebo_ros_camera"](plugin) == CameraPlugin()
