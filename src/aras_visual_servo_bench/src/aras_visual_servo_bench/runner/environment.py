"""A Gymnasium environment over an experiment: an agent asks the camera for a twist an image."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import relative_pose
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics.task import Task
from aras_visual_servo_controller.observation.image_reader import ImageReader
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.records.state import CONVERGED
from aras_visual_servo_controller.schemes import JointController, Scheme, SchemeOutput

from ..errors import ExperimentError
from ..experiment.experiment import Experiment, Sampler
from ..setup.assembly import assemble
from .loop import Loop

ENVIRONMENT = "aras/Servo-v0"  # its name in Gymnasium's registry
OBSERVATIONS = ("features", "image")
MAX_TWIST = (0.25, 0.25, 0.25, 1.5, 1.5, 1.5)  # m/s and rad/s of the camera, for an action of 1


class ExternalTwistScheme(Scheme):
    """Measures as another scheme does and asks for the twist that somebody else has chosen."""

    def __init__(self, inner: Scheme) -> None:
        super().__init__(inner.law)
        self.inner = inner
        self.twist = np.zeros(6)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the inner scheme's features."""
        return self.inner.names

    @property
    def tolerances(self) -> tuple[float, ...]:
        """Of the inner scheme."""
        return tuple(self.inner.tolerances)

    @property
    def needs(self) -> frozenset:
        """Of the inner scheme."""
        return self.inner.needs

    @property
    def cameras(self) -> tuple[str, ...]:
        """Of the inner scheme."""
        return tuple(self.inner.cameras)

    def get_needs(self, *cameras: str) -> frozenset:
        """As the inner scheme."""
        return self.inner.get_needs(*cameras)

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """As the inner scheme."""
        return self.inner.teach(observation)

    def check(self, goal: Goal) -> None:
        """As the inner scheme."""
        self.inner.check(goal)

    def reset(self) -> None:
        """As the inner scheme; no twist is asked for."""
        self.inner.reset()
        self.twist = np.zeros(6)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """The inner scheme's features with the chosen twist, in the directions they model."""
        decision = self.inner.compute(observation, goal, t)
        modelled = decision.task.modelled
        return dataclasses.replace(decision, task=Task.from_twist(self.twist, modelled))


class ServoEnv(gymnasium.Env):
    """One episode is one run of the experiment; a step lasts from one image to the next.

    Action: (6,) in [-1, 1], the camera's twist in parts of `max_twist`; what the features do not
    model is held, as for any scheme. Observation: the features' errors (k,) and the joints (n,),
    or the control camera's picture in grey levels, (rows, columns) uint8. Reward: minus the norm
    of the errors in units of their first; 1 more where the goal is held. An episode ends
    (terminated) when the loop has converged or lost its target, and is cut off (truncated) when
    the experiment's duration is over. `info` names outcome and verdict, and knows for teachers
    where the goal is: `camera_T_goal` (4, 4), true, now.

    Attributes:
        loop: the closed loop that is stepped, another one in each episode; None once it is closed.

    Many at once: `gymnasium.make_vec(ENVIRONMENT, 8, "async", experiment=...)`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(
        self,
        experiment: Experiment | None = None,
        max_twist: tuple[float, ...] = MAX_TWIST,
        render_mode: str | None = None,
        observes: str = "features",
    ) -> None:
        """Args:
            experiment: by default a free camera with exact features from sampled starts.
            observes: 'features' or 'image'.

        Raises:
            ExperimentError: it cannot be run, its scheme answers joints itself, or it has no
                pictures where these are to be observed.
        """
        if experiment is None:
            experiment = Experiment(plant="free", lag=0.0, delay=0.0, start=Sampler())
        if observes not in OBSERVATIONS:
            raise ExperimentError(f"observes is '{observes}': {suggest(observes, OBSERVATIONS)}")
        self._observes_images = observes == "image"
        if self._observes_images and not experiment.has_images:
            raise ExperimentError(
                "images cannot be observed of exact features: give the experiment features: "
                "images"
            )
        self.experiment = experiment
        self.render_mode = render_mode
        self._max_twist = np.array(max_twist, float)
        if self._max_twist.shape != (6,) or not (self._max_twist > 0.0).all():
            raise ExperimentError("greatest must hold six numbers above 0, m/s and rad/s")
        self.loop: Loop | None = None
        self._start_episode(experiment)
        if self._observes_images:
            size = self.loop.plant.camera.height, self.loop.plant.camera.width
            self.observation_space = spaces.Box(0, 255, size, np.uint8)
        else:
            size = len(self._scheme.names) + len(self.loop.plant.joint_names)
            self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (6,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; the seed draws start and noise."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31))
        self._start_episode(dataclasses.replace(self.experiment, seed=drawn))
        return self._make_observation(), self._make_info()

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Ask for a twist until the next image."""
        action = np.asarray(action, float)
        if action.shape != (6,) or not np.isfinite(action).all():
            raise ExperimentError(f"an action is six finite numbers, got {action}")
        self._scheme.twist = np.clip(action, -1.0, 1.0) * self._max_twist
        state = self.loop.run_to_image()
        lost = state is not None and state.scheme_output is None
        reached = state is not None and state.phase == CONVERGED
        reward = -float(np.linalg.norm(self._error)) / self._initial_error + float(reached)
        return self._make_observation(), reward, lost or reached, state is None, self._make_info()

    def render(self) -> np.ndarray | None:
        """The latest picture (rows, columns, 3), rgb; None where features are exact."""
        reading = self.loop.reading
        if reading is None or not reading.has_image:
            return None
        return ImageReader.decode_image(reading).rgb

    def close(self) -> None:
        """Give back what the plant holds."""
        if self.loop is not None:
            self.loop.close()
            self.loop = None

    def _start_episode(self, experiment: Experiment) -> None:
        self.close()
        self.loop = Loop(experiment, assemble(experiment, self._wrap_scheme))
        self.loop.run_to_image()
        self._initial_error = max(float(np.linalg.norm(self._error)), 1e-9)

    def _wrap_scheme(self, inner: Scheme | JointController) -> ExternalTwistScheme:
        if isinstance(inner, JointController):
            raise ExperimentError(
                f"scheme '{self.experiment.scheme}' answers joints itself: an environment needs "
                "one that asks for a twist"
            )
        self._scheme = ExternalTwistScheme(inner)
        return self._scheme

    @property
    def _error(self) -> np.ndarray:
        state = self.loop.state
        if state is None or state.scheme_output is None:
            return np.zeros(len(self._scheme.names))
        return state.scheme_output.error

    def _make_observation(self) -> np.ndarray:
        if self._observes_images:
            return ImageReader.decode_image(self.loop.reading).grey
        return np.concatenate([self._error, self.loop.plant.read_joints()[0]])

    def _make_info(self) -> dict[str, Any]:
        run = self.loop.compute_verdict()
        outcome = self.loop.servo.outcome
        return {
            "outcome": outcome.kind, "reason": outcome.reason, "verdict": run.name,
            "distance": run.distance, "angle": run.angle,
            "camera_T_goal": relative_pose(self.loop.plant.read_pose(),
                self.loop.compute_goal_pose()),
        }  # fmt: skip


gymnasium.register(ENVIRONMENT, entry_point=ServoEnv)
