"""Robot of joints in a row, with a camera at its end and a position controller a joint."""

HEAD = """<link name="camera_link"/><link name="camera_optical_frame"/>
<joint name="mount" type="fixed"><parent link="{hand}"/><child link="camera_link"/>
  <origin xyz="0 0 0" rpy="0 {pitch} 0"/></joint>
<joint name="optical" type="fixed"><parent link="camera_link"/><child link="camera_optical_frame"/>
  <origin rpy="-1.570796326794897 0 -1.570796326794897"/></joint>
<gazebo reference="camera_link"><sensor type="camera" name="camera"><update_rate>30</update_rate>
  <camera name="eye"><horizontal_fov>1.3</horizontal_fov>
    <image><width>320</width><height>240</height><format>R8G8B8</format></image>
    <clip><near>0.01</near><far>20</far></clip></camera>
  <plugin name="camera_controller" filename="libgazebo_ros_camera.so"><updateRate>0</updateRate>
    <cameraName>eye</cameraName><imageTopicName>image_raw</imageTopicName>
    <cameraInfoTopicName>camera_info</cameraInfoTopicName><frameName>camera_link</frameName>
  </plugin></sensor></gazebo>
<gazebo><plugin name="control" filename="libgazebo_ros_control.so">
  <robotNamespace>/arm</robotNamespace></plugin></gazebo>"""
LINK = """<link name="{name}_link"><inertial><mass value="1"/>
  <inertia ixx="0.02" iyy="0.01" izz="0.015" ixy="0" ixz="0" iyz="0"/></inertial>{solid}</link>
<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>
  <origin xyz="{at}"/><axis xyz="{axis}"/>
  <limit lower="{low}" upper="{high}" velocity="2" effort="900"/></joint>
<transmission name="{name}_t"><type>transmission_interface/SimpleTransmission</type>
  <joint name="{name}"><hardwareInterface>hardware_interface/PositionJointInterface
  </hardwareInterface></joint><actuator name="{name}_motor"/></transmission>"""


def write_arm(joints, pitch, folder, extra=""):
    """Write the files of a robot, and return the keys of an experiment's `robot`.

    joints: name, prismatic, origin in the parent, axis, range, and the shapes of the link, as XML.
    pitch: of the camera's link at the last joint, rad. extra: further links and joints.
    """
    links, parent = "", "world"
    for name, slides, at, axis, (low, high), solid in joints:
        links += LINK.format(name=name, kind="prismatic" if slides else "revolute", parent=parent,
                             at=at, axis=axis, low=low, high=high, solid=solid)
        parent = f"{name}_link"
    head = HEAD.format(hand=parent, pitch=pitch)
    (folder / "arm.urdf").write_text(
        f'<robot name="arm"><link name="world"/>{links}{extra}{head}</robot>')
    states = "joint_state_controller: {type: joint_state_controller/JointStateController, " \
        "publish_rate: 100}\n"
    (folder / "arm.yaml").write_text(states + "".join(
        f"{name}_c: {{type: position_controllers/JointPositionController, joint: {name}}}\n"
        for name, *_ in joints
    ))  # fmt: skip
    return {"urdf": str(folder / "arm.urdf"), "config": str(folder / "arm.yaml"),
            "namespace": "/arm"}
