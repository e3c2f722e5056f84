"""Two arms in one world: each arm has a camera in its hand and is controlled by its own servo loop.
"""

import cv2
import numpy as np
import yaml
from output import EXAMPLES, folder

from aras_sim_bridge import Pose, Simulation, load_description, load_world, populate
from aras_visual_servo_controller import (
    Arm,
    CameraModel,
    DifferentialIK,
    FeatureObserver,
    Goal,
    JointSample,
    Servo,
    create_law,
    create_scheme,
)

BLACK = "<material><ambient>0 0 0 1</ambient><diffuse>0 0 0 1</diffuse></material>"
BOX = ("<visual name='{}'><pose>{} {} 0 0 0 0</pose><geometry><box><size>{} {} 0.001</size></box>"
       f"</geometry>{BLACK}</visual>")  # fmt: skip
L = BOX.format("long", 0, 0, 0.12, 0.04) + BOX.format("short", -0.04, 0.04, 0.04, 0.04)
CAMERA = """<model name='room'><static>1</static><pose>2.1 0 1.3 0 0.52 3.14159</pose>
  <link name='l'><sensor name='s' type='camera'><update_rate>25</update_rate><camera>
  <horizontal_fov>1.0</horizontal_fov><image><width>640</width><height>320</height></image></camera>
  <plugin name='p' filename='libgazebo_ros_camera.so'><cameraName>room</cameraName></plugin>
  </sensor></link></model>"""
SIDES = {"left": 0.7, "right": -0.7}  # y of the base of each arm, m
OFFSETS = ((0.12, -0.08, 0.1, 0.05, -0.05, 0.2), (-0.1, 0.05, -0.1, 0.0, 0.1, -0.25))  # rad
ABOVE, DURATION = 0.25, 2.0  # distance from camera to target at the goal, m; time, s


def make_world() -> str:
    """Return a world file with an L on the table of each arm, and a camera in the room."""
    targets = "".join(
        f"<model name='{name}_target'><static>1</static><pose>0.45 {y + 0.05} 0.051 0 0 {0.3 * y}"
        f"</pose><link name='l'>{L}</link></model>" for name, y in SIDES.items())  # fmt: skip
    return f"<sdf version='1.6'><world name='w'>{targets}{CAMERA}</world></sdf>"


class ServoedArm:
    """An arm of the simulation with its own servo loop.

    The goal is taught with the camera above the target, before the arm moves to its start.
    """

    def __init__(self, simulation, name, y, out):
        """Add the arm with the topics below /name at the position y, m, of its base."""
        text = (EXAMPLES / "my_arm.urdf").read_text().replace("/aras_visual_servo", f"/{name}")
        (out / f"{name}.urdf").write_text(text.replace("labrob/camera", f"{name}/camera"))
        parameters = yaml.safe_load((EXAMPLES / "my_arm_controllers.yaml").read_text())
        self.simulation, self.arm, self.images = simulation, Arm.from_urdf(text), []
        at_goal = Pose.from_rpy((0.45, 0.05, 0.05 + ABOVE), (np.pi, 0.0, 0.0))
        self.goal = self.arm.inverse_kinematics(at_goal.matrix(), np.zeros(6))
        simulation.spawn(
            load_description(out / f"{name}.urdf"), name, Pose((0.0, y, 0.0)), f"/{name}",
            parameters["aras_visual_servo"],
            joint_positions=dict(zip(self.arm.names, self.goal, strict=True)),
        )  # fmt: skip
        self.robot = simulation.robots[name]
        self.robot.start(f"{joint}_position_controller" for joint in self.arm.names)
        self.camera = simulation.camera(f"/{name}/camera")
        self.camera.on_frame, self.camera.enabled = self.images.append, True

    def read_joints(self):
        """Return the measured joints at the present time."""
        positions, velocities, _ = self.robot.model.read_joints()
        rows = [self.robot.model.joint_names.index(name) for name in self.arm.names]
        stamp = self.simulation.time_ns / 1e9
        return JointSample.from_values(
            stamp, self.arm.names, np.array(positions)[rows], np.array(velocities)[rows]
        )

    def observe(self, frame, observer):
        """Measure the corners in a frame."""
        info = self.camera.sensor.info
        camera = CameraModel(info.width, info.height, tuple(np.ravel(info.K)), tuple(info.D))
        return observer.observe_image(frame.stamp_ns / 1e9, frame.image, camera, self.read_joints())

    def teach(self):
        """Teach the goal with the latest image, and make the loop."""
        scheme = create_scheme("points", create_law("proportional", gain=4.0))
        seen = self.observe(self.images[-1], FeatureObserver(self.arm, scheme.needs))
        goal = Goal.teach(scheme, seen, depth=ABOVE)
        self.servo = Servo(scheme, self.arm, goal, DifferentialIK(self.arm))
        self.observer = FeatureObserver(
            self.arm, scheme.needs, compute_plane=self.servo.goal.compute_plane
        )

    def command(self, positions):
        """Send the joint positions (6,), rad."""
        for name, position in zip(self.arm.names, positions, strict=True):
            self.robot.command(f"{name}_position_controller", position)

    def update(self):
        """Process a new image, if there is one, and send the next command."""
        if self.images:
            self.servo.process_image(self.observe(self.images[-1], self.observer))
            self.images.clear()
        joints = self.read_joints()
        self.command(self.servo.update(joints.stamp, joints).positions)


out = folder()
(out / "two_arms.world").write_text(make_world())
simulation = Simulation()
populate(simulation.spawn, load_world(out / "two_arms.world"))
arms = [ServoedArm(simulation, name, y, out) for name, y in SIDES.items()]
room, views = simulation.camera("/room"), []
room.on_frame, room.enabled = views.append, True


def advance(seconds, update=None):
    """Simulate for a time, s, and call update() of each arm after every fifth step, if given."""
    for k in range(round(seconds * 1e9 / simulation.step_ns)):
        simulation.step()
        if update and k % 5 == 0:
            for arm in arms:
                update(arm)


advance(0.1)
for arm, offset in zip(arms, OFFSETS, strict=True):
    arm.teach()
    arm.command(arm.goal + np.array(offset))  # the start
advance(0.3)
hands = [arm.images[-1].image for arm in arms]
advance(DURATION, ServoedArm.update)
for arm, name in zip(arms, SIDES, strict=True):
    pose, goal = arm.arm.pose(arm.read_joints().positions), arm.arm.pose(arm.goal)
    distance = np.linalg.norm(pose[:3, 3] - goal[:3, 3])
    print(f"{name}: {arm.servo.phase}, {1e3 * distance:.2f} mm from its goal")
    assert distance < 1e-3
# The room, in which the right arm is on the left, and below the two views at the start.
pair = np.hstack([cv2.resize(image, (320, 240)) for image in reversed(hands)])
for end in ((320, 240), (640, 0)):
    cv2.line(pair, (end[0] % 640, 0), end, (0, 0, 0), 2)
cv2.imwrite(str(out / "picture.png"), np.vstack([views[-1].image, pair])[..., ::-1])
print(out / "picture.png")
simulation.close()
