"""Topics of the p3d, IMU and force/torque plugins: names, frames, stamps, values."""

from __future__ import annotations

import pytest
import rospy
from gazebo_calls import INERTIA, call, spawn, step
from gazebo_msgs.msg import ContactsState, LinkStates
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from ros_graph import wait_for
from sensor_msgs.msg import Imu
from std_srvs.srv import Empty

PLUGIN = '<plugin name="p" filename="libgazebo_ros_{}.so">{}</plugin>'
ARM = f"""<robot name="probe"><link name="world"/>
<joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
<origin xyz="0 0 2" rpy="0.5 0 0"/></joint>
<link name="base"><inertial><mass value="3"/>{INERTIA}</inertial></link>
<joint name="swing" type="continuous"><parent link="base"/><child link="tool"/>
<axis xyz="0 1 0"/></joint>
<link name="tool"><inertial><origin xyz="0.1 0 -0.3"/><mass value="2"/>{INERTIA}</inertial></link>
<gazebo reference="base"><sensor name="i" type="imu"><update_rate>200</update_rate>{PLUGIN.format(
    "imu_sensor", "<frameName>base_imu</frameName><updateRateHZ>50</updateRateHZ>"
    "<gaussianNoise>0</gaussianNoise>")}</sensor></gazebo>
<gazebo>{PLUGIN.format("p3d", "<robotNamespace>/truth</robotNamespace><bodyName>tool</bodyName>"
                       "<topicName>odom</topicName><gaussianNoise>0</gaussianNoise>")}</gazebo>
<gazebo>{PLUGIN.format("ft_sensor", "<jointName>stand</jointName><topicName>/wrist/ft</topicName>"
                       "<updateRate>25</updateRate>")}</gazebo>
<gazebo>{PLUGIN.format("gpu_laser", "")}</gazebo></robot>"""


@pytest.fixture(scope="module", autouse=True)
def machine(launch, ros_node):
    rospy.set_param("/truth/tf_prefix", "one")
    launched = launch(
        "aras_sim_bridge", "empty_world.launch", nodes=["/gazebo"], paused=True, speed_mode="max")
    spawn("probe", ARM)
    said = "libgazebo_ros_gpu_laser.so' is ignored"
    wait_for(lambda: said in launched.output(), 10.0, said)
    return launched


def test_p3d_is_link_states_to_the_bit(collect):
    odometry, states = collect("/truth/odom", Odometry), collect("/gazebo/link_states", LinkStates)
    wait_for(lambda: odometry.connected() and states.connected(), 10.0, "connections")
    step(20)
    last = odometry.wait(19)
    wait_for(lambda: states.messages, 10.0, "link states")
    told = states.messages[-1]
    index = told.name.index("probe::tool")
    assert odometry.messages[-1] is last
    assert (last.pose.pose, last.twist.twist) == (told.pose[index], told.twist[index])
    assert (last.header.frame_id, last.child_frame_id) == ("one/world", "tool")
    stamps = [m.header.stamp.to_nsec() for m in odometry.messages]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == [1_000_000] * 18


def test_imu_and_wrench_come_at_their_rates(collect):
    imus, wrenches = collect("/probe/imu_data", Imu), collect("/wrist/ft", WrenchStamped)
    wait_for(lambda: imus.connected() and wrenches.connected(), 10.0, "connections")
    call("reset_simulation", Empty)
    step(200)
    imus.wait(10)
    wrenches.wait(5)
    assert [m.header.stamp.to_nsec() // 1_000_000 for m in imus.messages] == list(
        range(20, 201, 20))
    assert [m.header.stamp.to_nsec() // 1_000_000 for m in wrenches.messages] == list(
        range(40, 201, 40))
    imu = imus.messages[-1]
    assert imu.header.frame_id == "base_imu"
    felt = imu.linear_acceleration
    assert (felt.x, felt.y, felt.z) == pytest.approx((0, 9.8 * 0.479426, 9.8 * 0.877583), abs=1e-4)
    assert wrenches.messages[-1].header.frame_id == "base"
    assert wrenches.messages[0].wrench.force.z < -9.8 * 3.0


def test_a_deleted_model_takes_its_topics_along():
    from gazebo_msgs.srv import DeleteModel

    call("delete_model", DeleteModel, "probe")
    topics = [name for name, _ in rospy.get_published_topics()]
    assert not {"/truth/odom", "/probe/imu_data", "/wrist/ft"} & set(topics)


CRATE = f"""<robot name="crate"><link name="body"><inertial><mass value="10"/>{INERTIA}</inertial>
<collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.3 0.2"/></geometry></collision></link>
<gazebo reference="body"><sensor name="c" type="contact"><update_rate>100</update_rate>
<contact><collision>body_collision</collision></contact>{PLUGIN.format(
    "bumper", "<robotNamespace>/feet</robotNamespace><bumperTopicName>ground</bumperTopicName>"
    "<frameName>body</frameName>")}</sensor></gazebo></robot>"""


def test_a_bumper_tells_what_the_ground_bears(collect):
    spawn("crate", CRATE)
    step(200)
    told = collect("/feet/ground", ContactsState)
    wait_for(told.connected, 10.0, "a connection")
    step(100)
    message = told.wait(10)
    (state,) = message.states
    assert (state.collision1_name, state.collision2_name) == (
        "crate::body::body_collision", "ground_plane::link::collision")
    total = state.total_wrench.force
    assert (total.x, total.y, total.z) == pytest.approx((0.0, 0.0, 98.0), abs=0.02)
    count = len(state.contact_positions)
    assert count >= 2 and count == len(state.contact_normals) == len(state.depths)
    assert sum(one.force.z for one in state.wrenches) == pytest.approx(total.z)
    assert state.info.startswith("Debug:  i:(0/1)     my geom:crate::body::body_collision   other")
    assert message.header.frame_id == "body"
    stamps = [m.header.stamp.to_nsec() for m in told.messages]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == [10_000_000] * 9
