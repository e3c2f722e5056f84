"""Gymnasium environment of an experiment, in which an agent commands one camera twist per image."""

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
from aras_visual_servo_controller.observation.feature_extractor import FeatureExtractor
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.records.state import CONVERGED
from aras_visual_servo_controller.schemes import JointController, Scheme, SchemeOutput

from ..errors import ExperimentError
from ..experiment.experiment import Experiment, RandomStart
from ..setup.assembly import assemble
from .loop import Loop

ENVIRONMENT = "aras/Servo-v0"  # name of the environment in Gymnasium's registry
OBSERVATIONS = ("features", "image")
# twist of an action whose six components are 1, m/s and rad/s
MAX_TWIST = (0.25, 0.25, 0.25, 1.5, 1.5, 1.5)


class ExternalTwistScheme(Scheme):
    """Scheme that measures the features of another scheme, but commands a twist set from outside.

    Attributes:
        inner: the other scheme.
        twist: camera twist (6,) to command, m/s and rad/s.
    """

    def __init__(self, inner: Scheme) -> None:
        super().__init__(inner.law)
        self.inner = inner
        self.twist = np.zeros(6)
        self._describe()

    def get_needs(self, *cameras: str) -> frozenset:
        """Return the data that the inner scheme needs from the cameras `cameras`."""
        return self.inner.get_needs(*cameras)

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Return the goal that the inner scheme extracts from an observation."""
        return self.inner.teach(observation)

    def check(self, goal: Goal) -> None:
        """Check the goal with the inner scheme."""
        self.inner.check(goal)
        self._describe()

    def reset(self) -> None:
        """Reset the inner scheme, and set the twist to zero."""
        self.inner.reset()
        self.twist = np.zeros(6)

    def _describe(self) -> None:
        """Copy the description of the inner scheme, which can depend on the goal."""
        self.names, self.tolerances = self.inner.names, tuple(self.inner.tolerances)
        self.needs, self.cameras = self.inner.needs, tuple(self.inner.cameras)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the output of the inner scheme, and replace the task in it by the external twist.
        """
        output = self.inner.compute(observation, goal, t)
        modelled = output.task.modelled
        return dataclasses.replace(output, task=Task.from_twist(self.twist, modelled))


class ServoEnv(gymnasium.Env):
    """Gymnasium environment: an episode is a run of an experiment, and a step is one image.

    An action (6,) in [-1, 1] is the camera twist as a fraction of `max_twist`. Components of the
    twist that the scheme does not control have no effect, for example rotations if the scheme
    controls only the position. The observation is either the feature errors (k,) followed by the
    joint positions (n,), or the grey image (rows, columns), uint8, of the camera that is
    controlled. The reward is -|e| / |e0| with the feature errors e and their initial values e0,
    plus 1 while the loop is converged. An episode is terminated when the loop has converged or has
    lost its target, and truncated when the duration of the experiment is over. `info` contains the
    outcome that the loop reports, the verdict by the true camera pose, the distance (m) and angle
    (rad) to the goal, and the true pose `camera_T_goal` (4, 4), for example for imitation learning.

    `gymnasium.make_vec(ENVIRONMENT, 8, "async", experiment=...)` runs environments in parallel.

    Attributes:
        loop: run of the current episode; None after `close`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(
        self,
        experiment: Experiment | None = None,
        max_twist: tuple[float, ...] = MAX_TWIST,
        render_mode: str | None = None,
        observes: str = "features",
    ) -> None:
        """Start the first episode.

        Args:
            experiment: settings of the episodes; None: a free camera that starts at random poses,
                with features that are computed without images.
            max_twist: camera twist of an action whose components are all 1, m/s and rad/s.
            render_mode: None or 'rgb_array'; see `gymnasium.Env`.
            observes: content of an observation: 'features' or 'image'.

        Raises:
            ExperimentError: the experiment cannot be run, its scheme commands joints, or `observes`
                is 'image' but the experiment has no images.
        """
        if experiment is None:
            experiment = Experiment(plant="free", lag=0.0, delay=0.0, start=RandomStart())
        if observes not in OBSERVATIONS:
            raise ExperimentError(f"observes is '{observes}': {suggest(observes, OBSERVATIONS)}")
        self._observes_images = observes == "image"
        if self._observes_images and not experiment.has_images:
            raise ExperimentError(
                "observes is 'image', but exact features have no images: set features to images"
            )
        self.experiment = experiment
        self.render_mode = render_mode
        self._max_twist = np.array(max_twist, float)
        if self._max_twist.shape != (6,) or not (self._max_twist > 0.0).all():
            raise ExperimentError("max_twist must be six numbers above 0, m/s and rad/s")
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
        """Start an episode with new random numbers for the start and the noise.

        seed: seed of Gymnasium's random generator, which draws the seed of each episode.
        """
        super().reset(seed=seed)
        episode_seed = int(self.np_random.integers(2**31))
        self._start_episode(dataclasses.replace(self.experiment, seed=episode_seed))
        return self._make_observation(), self._make_info()

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Command a twist and run until the next image; see `gymnasium.Env.step`."""
        action = np.asarray(action, float)
        if action.shape != (6,) or not np.isfinite(action).all():
            raise ExperimentError(f"an action must be six finite numbers, got {action}")
        self._scheme.twist = np.clip(action, -1.0, 1.0) * self._max_twist
        state = self.loop.run_to_image()
        lost = state is not None and state.scheme_output is None
        reached = state is not None and state.phase == CONVERGED
        reward = -float(np.linalg.norm(self._error)) / self._initial_error + float(reached)
        return self._make_observation(), reward, lost or reached, state is None, self._make_info()

    def render(self) -> np.ndarray | None:
        """Return the latest image (rows, columns, 3), rgb; None if the experiment has no images."""
        reading = self.loop.reading
        if reading is None or not reading.has_image:
            return None
        return FeatureExtractor.decode_image(reading).rgb

    def close(self) -> None:
        """Release the resources of the plant, the simulated arm or camera."""
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
                f"scheme '{self.experiment.scheme}' commands joints: an environment needs a "
                "scheme that commands a twist"
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
            return FeatureExtractor.decode_image(self.loop.reading).grey
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
