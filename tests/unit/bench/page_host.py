"""Host of the live page without ROS: its robot follows requests, and requests are recorded."""

import threading

import cv2
import numpy as np

from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.visualization.run_drawing import RunDrawing
from aras_visual_servo_bench.web.live.page_state import PageState
from aras_visual_servo_bench.web.live.robot_model import make_robot_model
from aras_visual_servo_bench.web.live.server import PageHost
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes import SchemeOutput


def told(stamp=1.0, phase="servoing", names=("xn", "yn"), error=(0.01, -0.02), asked=(0.0,) * 6,
         achieved=(0.0,) * 6, scheme="moments", **words):  # fmt: skip
    error, none = np.array(error, float), np.zeros(0)
    decision = SchemeOutput(tuple(names), error, 0.0 * error, error)
    resolution = IKSolution.from_record(
        np.zeros(6), np.array(asked), np.array(achieved), (none, none))
    return ServoState(stamp, phase, **{"outcome": "running", **words}, scheme_output=decision,
                      ik_solution=resolution, scheme=scheme)  # fmt: skip


class OfflineHost(PageHost):
    """Host without a graph."""

    find_report = staticmethod(lambda path: None)  # function that returns a report's file
    has_robot = True

    def __init__(self, robot, camera) -> None:
        self.arm = robot.make_arm()
        self._robot = robot
        self.page, self.run_trace = PageState(), RunDrawing(self.arm)
        self.run_trace.camera = camera
        self.q = np.array([-0.1, 0.0, 0.349, -0.262, -0.087, 0.1745])
        self.goal = np.array([0.05, 0.0, -0.09, 0.045, 0.045, 0.0])
        self.run_trace.goal = np.array(self.arm.pose(self.goal))
        self.run_trace.outline = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
        self.run_trace.factor = 1.0
        self.asked, self.viewers, self.time, self.updates = [], [], 0.0, 0
        self.lock = threading.Lock()
        self.waited = threading.Event()
        arm = self.arm
        self.page.set_robot(arm.names, arm.lower, arm.upper, arm.velocity, arm.is_prismatic)
        self.page.choices = {
            "schemes": ["moments", "points"], "laws": ["proportional"], "starts": ["2015", "2016"],
            "goals": ["auto", "2016"], "cameras": ["original", "wide"], "targets": [],
            "gains": ["gain"], "joints": list(arm.names),
        }  # fmt: skip
        self.page.state = {"scheme": "moments", "gains": {"gain": 5.0}, "robot": 1,
                           "controller": True, "start": "2016", "camera": "original"}  # fmt: skip
        self.move()

    def move(self, phase: str = "servoing") -> None:
        with self.lock:
            self.time += 1 / 30
            step = 0.08 * (self.goal - self.q)
            self.q = self.q + step
            twist = tuple(self.arm.jacobian(self.q) @ step * 30.0)
            error = tuple((self.goal - self.q)[:4])
            said = told(self.time, phase, ("xn", "yn", "an", "alpha"), error, twist,
                        tuple(0.97 * v for v in twist))  # fmt: skip
            self.run_trace.set_joints(self.q)
            self.run_trace.add_state(said, self.q)
            self.run_trace.add_image_point("centre", 0.5 * error[0], 0.4 * error[2])
            self.page.add_sample(said, self.q)

    def make_update(self):
        self.updates += 1
        with self.lock:
            return self.page.make_update(self.run_trace, self.q, np.zeros(len(self.q)), self.time)

    def make_robot_model(self):
        if self.has_robot:
            return make_robot_model(self._robot.urdf, self._robot.packages.find)
        return None

    def take_image(self):
        image = np.full((240, 320, 3), 245, np.uint8)
        cv2.rectangle(image, (150, 100), (180, 130), (0, 0, 0), -1)
        cv2.rectangle(image, (145, 105), (175, 135), (255, 120, 60), 1)
        return cv2.imencode(".jpg", image)[1].tobytes()

    def set_viewer_count(self, viewers):
        self.viewers.append(viewers)

    def execute(self, request):
        self.asked.append(request)
        if request.do == "hold":
            raise RefusedRequestError("no controller here")
        if request.do == "pause":
            self.waited.set()
        if request.do == "report" and not self.waited.wait(10.0):
            raise RefusedRequestError("nobody else was heard meanwhile")
        if request.do == "reset":
            raise ZeroDivisionError("a fault")
        return f"done: {request.do}"

    def find_file(self, path):
        return self.find_report(path)
