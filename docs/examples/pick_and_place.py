#!/usr/bin/env python3
"""Pick up a box by visual servoing and place it elsewhere.

    python docs/examples/pick_and_place.py [number of boxes]

The arm of docs/my_robot.md gets a gripper. Visual servoing moves the camera in its hand to 0.2 m
above the L on top of a loose box. Then the hand moves straight down, closes, lifts the box, rotates
it and places it at a given pose. The position of the box is known only from the images. The script
prints the position error of each box; its exit status is 1 if an error is above 5 mm.
"""

from __future__ import annotations

import math
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import yaml

from aras_sim_bridge import GripperGoal, Pose
from aras_visual_servo_bench import Experiment, Loop, assemble
from aras_visual_servo_controller import ServoError

HERE = Path(__file__).resolve().parent
TABLE, BOX = 0.05, (0.07, 0.04, 0.06)  # height of the table and size of the box, m
ABOVE = 0.2  # distance from the camera to the top of the box at the goal, m
TIPS = 0.11  # distance from the camera to the fingertips along its optical axis, m
PLACE, YAW = (0.42, -0.18, TABLE), 0.5  # goal of the boxes, m and rad (modulo half a turn)
GAINS = {"pan": (4000.0, 150.0), "lift": (4000.0, 150.0), "elbow": (3000.0, 100.0),
         "wrist_roll": (300.0, 4.0), "wrist_pitch": (300.0, 4.0), "turn": (60.0, 0.8)}  # fmt: skip
OPEN, SHUT = 0.0, 0.03  # position of each finger, m
FINGER = """<robot>
  <link name="{side}_finger">
    <inertial><mass value="0.1"/>
      <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.02 0.01 0.06"/></geometry></visual>
    <collision><geometry><box size="0.02 0.01 0.06"/></geometry></collision>
  </link>
  <joint name="{side}" type="prismatic">
    <parent link="flange"/><child link="{side}_finger"/>
    <origin xyz="0 {y} 0.11"/><axis xyz="0 {along} 0"/>
    <limit lower="0" upper="0.03" velocity="0.2" effort="40"/><dynamics damping="1"/>{mimic}
  </joint>
</robot>"""
MOTOR = """<transmission name="{joint}_motor">
  <type>transmission_interface/SimpleTransmission</type>
  <joint name="{joint}">
    <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
  <actuator name="{joint}_drive"/></transmission>"""


def with_gripper(folder: Path) -> dict[str, str]:
    """Return `robot` of an experiment: my_arm.urdf with effort controllers and a gripper.

    The table gets a collision shape, so that boxes can be placed on it.
    """
    robot = ElementTree.fromstring((HERE / "my_arm.urdf").read_text())
    for kind in robot.iter("hardwareInterface"):
        kind.text = "hardware_interface/EffortJointInterface"
    follows = '<mimic joint="left"/>'
    for side, y, mimic in (("left", 0.036, ""), ("right", -0.036, follows)):
        along = -math.copysign(1.0, y)
        robot.extend(ElementTree.fromstring(
            FINGER.format(side=side, y=y, along=along, mimic=mimic)))
    robot.append(ElementTree.fromstring(MOTOR.format(joint="left")))
    table = robot.find("link[@name='table']")
    ElementTree.SubElement(table, "collision").append(table.find("visual/geometry"))
    ElementTree.ElementTree(robot).write(folder / "arm.urdf")
    controllers = {
        f"{joint}_controller": {
            "type": "effort_controllers/JointPositionController", "joint": joint,
            "interpolate": True,
            "pid": {"p": p, "i": 3.0 * p, "d": d, "i_clamp_max": 80.0, "i_clamp_min": -80.0},
        }
        for joint, (p, d) in GAINS.items()
    }  # fmt: skip
    controllers["joint_state_controller"] = {
        "type": "joint_state_controller/JointStateController", "publish_rate": 200}
    controllers["gripper"] = {
        "type": "effort_controllers/GripperActionController", "joint": "left",
        "goal_tolerance": 0.001, "stall_timeout": 0.2,
        "gains": {"left": {"p": 4000.0, "d": 40.0}},
    }  # fmt: skip
    (folder / "controllers.yaml").write_text(yaml.safe_dump({"aras_visual_servo": controllers}))
    return {"urdf": str(folder / "arm.urdf"), "config": str(folder / "controllers.yaml")}


def experiment(robot: dict[str, str], seed: int) -> Experiment:
    """Return an experiment with a random pose of the box and a random start of the camera."""
    draw = np.random.default_rng(seed)
    x, y, turn = draw.uniform((0.40, -0.03, -0.6), (0.50, 0.12, 0.6))
    top = TABLE + BOX[2] + 5e-4
    target = {"shape": "l_shape", "size": [0.05, 0.03], "pose": [x, y, top, 0, 0, turn],
              "box": {"size": list(BOX), "mass": 0.2, "friction": 0.8}}  # fmt: skip
    away = draw.uniform(-1.0, 1.0, 6) * (0.012, 0.012, 0.01, 0.03, 0.03, 0.3)
    # The fingers close along the image's x axis, which must be parallel to the box's narrow side.
    goal = [x, y, top + ABOVE, math.pi, 0.0, turn - math.pi / 2]
    return Experiment(
        # With this field of view, the L is 100 px wide from 0.2 m, and the fingers are not visible.
        plant="bullet", robot=robot, camera={"horizontal_fov": 0.5}, target=target,
        features="images", scheme="points", gain=2.0, duration=20.0, goal={"pose": goal},
        start={"pose": (np.array(goal) + (*away[:2], away[2] + 0.03, *away[3:])).tolist()},
    )  # fmt: skip


class Hand:
    """Motions of the arm and its gripper after servoing."""

    def __init__(self, loop: Loop, robot: dict[str, str]) -> None:
        self.simulation = loop.plant.simulation
        self.robot = self.simulation.robots["robot"]
        self.robot.start(["gripper"])
        self.gripper = self.robot.manager.get("gripper")
        self.arm = loop.servo.arm
        self.joints = loop.plant.read_joints()[0]
        self.camera = self.arm.pose(self.joints)

    def go(self, camera: np.ndarray, speed: float = 0.2) -> None:
        """Move the camera to a pose (4, 4) in the world by a smooth joint motion.

        speed: mean speed of the camera, m/s.
        """
        displacement = camera[:3, 3] - self.camera[:3, 3]
        count = max(int(1000.0 * np.linalg.norm(displacement) / speed), 700)
        start, end = self.joints, self.arm.inverse_kinematics(camera, self.joints)
        for k in range(1, count + 1):
            part = 0.5 - 0.5 * math.cos(math.pi * k / count)
            for joint, value in zip(self.arm.names, start + part * (end - start), strict=True):
                self.robot.command(f"{joint}_controller", value)
            self.simulation.step()
        self.joints, self.camera = end, camera

    def find_goal_pose(self, box_T_camera: np.ndarray) -> np.ndarray:
        """Return a reachable camera pose (4, 4) for which the box is at its goal."""
        for half_turns in (0, 1):
            x, y, z = PLACE
            turn = YAW + half_turns * math.pi
            box = Pose.from_rpy((x, y, z + BOX[2]), (0.0, 0.0, turn))
            camera = box.matrix() @ box_T_camera
            try:
                self.arm.inverse_kinematics(camera, self.joints)
            except ServoError:
                continue
            return camera
        raise SystemExit(f"the goal {PLACE} of the box is out of reach of the arm")

    def grip(self, position: float, effort: float) -> bool:
        """Move the fingers; return True if an object stops them."""
        handle = self.gripper.submit_goal(GripperGoal(position, effort))
        for _ in range(3000):
            self.simulation.step()
            if handle.is_done:
                break
        return handle.is_done and handle.result.stalled


def down(camera: np.ndarray, distance: float) -> np.ndarray:
    """Return a camera pose, moved along its optical axis by a distance, m."""
    moved = camera.copy()
    moved[:3, 3] += distance * camera[:3, 2]
    return moved


def pick_and_place(robot: dict[str, str], seed: int) -> tuple[float, float] | str:
    """Pick and place one box; return its position and angle error, m and rad, or a failure text."""
    trial = experiment(robot, seed)
    loop = Loop(trial, assemble(trial))
    try:
        loop.run_to_end()
        if not loop.make_run().converged:
            return f"the servo ended with {loop.make_run().outcome}"
        hand, box = Hand(loop, robot), loop.plant.simulation.world.models["target"]
        # Pose of the camera in the frame of the box at the goal.
        box_T_camera = Pose.from_rpy((0.0, 0.0, ABOVE), (math.pi, 0.0, -math.pi / 2)).matrix()
        reach = ABOVE - TIPS + 0.03  # the fingertips are then 30 mm below the top of the box
        hand.grip(OPEN, 20.0)
        over = hand.camera
        hand.go(down(over, reach))
        if not hand.grip(SHUT, 20.0):
            return "the gripper closed without the box"
        hand.go(over)
        if box.pose().xyz[2] < TABLE + BOX[2] + 0.05:
            return "the box slipped out"
        above_goal = hand.find_goal_pose(box_T_camera)
        hand.go(above_goal)
        hand.go(down(above_goal, reach - 0.001), 0.05)
        hand.grip(OPEN, 20.0)
        hand.go(above_goal)
        final = box.pose().matrix()
        error = math.dist(final[:2, 3], PLACE[:2])
        turned = math.atan2(final[1, 0], final[0, 0]) - YAW
        return error, abs((turned + math.pi / 2) % math.pi - math.pi / 2)
    finally:
        loop.close()


def main() -> int:
    """Pick and place several boxes; return the exit status."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    good = 0
    with tempfile.TemporaryDirectory() as folder:
        robot = with_gripper(Path(folder))
        for seed in range(count):
            found = pick_and_place(robot, seed)
            if isinstance(found, str):
                print(f"box {seed}: {found}", flush=True)
                continue
            good += found[0] < 5e-3 and found[1] < math.radians(3.0)
            print(f"box {seed}: {1e3 * found[0]:.1f} mm and {math.degrees(found[1]):.1f} degrees "
                  "from its goal", flush=True)
    print(f"{good} of {count} boxes at their goal")
    return 0 if good == count else 1


if __name__ == "__main__":
    sys.exit(main())
