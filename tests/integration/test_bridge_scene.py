"""Contents of the world: SDF models, models from `spawn_model`, and world files."""

from __future__ import annotations

import math
import subprocess

import pytest
from gazebo_calls import ARM, BRICK, LAMP, SHAPES, at, call, delete, place, spawn, step
from gazebo_msgs.srv import GetJointProperties, GetLinkState, GetModelProperties, GetWorldProperties
from ros_graph import wait_for
from std_srvs.srv import Empty


@pytest.fixture(scope="module", autouse=True)
def world(launch, ros_node):
    """Ground and sun, standing still."""
    return launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max"
    )


@pytest.fixture(scope="module")
def mesh() -> str:
    from pathlib import Path

    folder = Path(__file__).parents[2] / "src/aras_visual_servo_gazebo/meshes"
    return sorted(path.name for path in folder.glob("*.stl"))[0]


def test_sdf_pose_is_composed_with_the_initial_pose_and_the_reference(mesh):
    spawn("table", SHAPES.format(mesh=mesh), "sdf", initial_pose=at(2, 0, 0, math.pi / 2))
    assert place("table") == pytest.approx((2, 0, 1))
    spawn("second", SHAPES.format(mesh=mesh), "sdf", initial_pose=at(1, 0, 0),
          reference_frame="table")  # fmt: skip
    # 1 m along the table's x, which points along the world's y; twice 1 m up.
    assert place("second") == pytest.approx((2, 1, 2))
    leg = call("get_link_state", GetLinkState, "table::leg", "map").link_state.pose.position
    assert (leg.x, leg.y, leg.z) == pytest.approx((2, 0, 0.5))
    near = call("get_link_state", GetLinkState, "table::leg", "second").link_state.pose.position
    assert (near.x, near.y, near.z) == pytest.approx((-1, 0, -1.5))
    properties = call("get_model_properties", GetModelProperties, "table")
    assert properties.is_static
    assert properties.body_names == ["top", "leg"]
    assert properties.geom_names == ["c", "knob"]
    assert properties.canonical_body_name == ""
    delete("second")
    names = call("get_world_properties", GetWorldProperties).model_names
    assert names == ["ground_plane", "table"]


def test_spawn_model_script_with_its_options(world, tmp_path):
    """-reference_frame, -J, -wait, -package_to_model, -b; exit status on refusal."""
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    script = ["rosrun", "aras_sim_bridge", "spawn_model", "-urdf", "-file", str(file)]
    plate = SHAPES.partition('<link name="leg"')[0] + "</model></sdf>"
    spawn("stand", plate, "sdf", initial_pose=at(0, 6, 5, math.pi / 2))
    bound = subprocess.Popen(
        [*script, "-model", "arm", "-wait", "late", "-reference_frame", "stand::top", "-x", "1",
         "-z", "2", "-Y", "0.5", "-J", "swing", "0.25", "-package_to_model", "-b"],
        env=world.master.environment,
    )  # fmt: skip
    try:
        call("unpause_physics", Empty)
        call("pause_physics", Empty)
        assert "arm" not in call("get_world_properties", GetWorldProperties).model_names
        spawn("late", BRICK, "sdf", initial_pose=at(9, 9, 5))

        def there() -> bool:
            step(1)  # model_states come with steps
            return call("get_joint_properties", GetJointProperties, "swing").position == (0.25,)

        wait_for(there, timeout=20.0, what="the arm", interval=0.1)
        assert place("arm")[:2] == pytest.approx((0, 7))
        again = world.master.run([*script, "-model", "arm"], check=False)
        assert again.returncode == 1
        assert "exists" in again.stdout + again.stderr
    finally:
        bound.send_signal(2)
        bound.wait(10.0)
    assert "arm" not in call("get_world_properties", GetWorldProperties).model_names
    delete("stand", "late")


def test_world_file_is_built(launch, tmp_path):
    """Models, lights, gravity and step of an SDF world; a model that cannot be is named."""
    lamp = LAMP.partition("<light")[2].partition("</sdf>")[0]
    brick = BRICK.partition("<model")[2].partition("</sdf>")[0]
    path = tmp_path / "room.world"
    path.write_text(
        f"""<sdf version="1.6"><world name="room"><gravity>0 0 -1</gravity>
        <physics type="ode"><max_step_size>0.002</max_step_size></physics>
        <model{brick}<light{lamp}<include><uri>model://ground_plane</uri></include></world></sdf>"""
    )
    launched = launch("aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], own_master=True,
                      paused=True, world_name=path)  # fmt: skip
    run = launched.master.run
    run(["rosservice", "call", "--wait", "/gazebo/step_world", "1"])
    told = run(["rosservice", "call", "/gazebo/get_world_properties"]).stdout
    assert "sim_time: 0.002" in told
    assert told.index("brick") < told.index("ground_plane")
    light = run(["rosservice", "call", "/gazebo/get_light_properties", "given"]).stdout
    assert "attenuation_quadratic: 0.125" in light


def test_log_holds_no_traceback(world):
    assert "Traceback" not in world.output()
    assert "internal error" not in world.output()
