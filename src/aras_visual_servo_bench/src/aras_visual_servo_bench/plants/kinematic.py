"""Plants without physics: a chain of joints that lags, a camera that flies.

Time goes from one measurement to the next in a single exact step, however long it is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.camera.effects import EffectChain
from aras_sim_bridge.camera.shutter import RowBand
from aras_visual_servo_base.poses import exponential
from aras_visual_servo_camera.moments import find_crossing
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm

from ..asked import cameras
from ..errors import ExperimentError, ViewError
from ..targets.geometry import PlacedTarget, project
from ..targets.pictures import seen
from ..targets.solids import SolidTarget
from ..targets.textures import TexturedTarget
from .base import CAMERA, CameraReading, JointReading, Place, Plant, Reading
from .free_body import FreeBody
from .rolling import rolling

NS = 1_000_000_000
OCCLUDED = 128  # grey level of the cover's own drawing from which on it hides
TRIES = 100  # draws of an outline's noise
JOINT_PHASE_NS = 1_000_000  # joint states come a millisecond after the hundredths, as in physics


@dataclass(frozen=True)
class Sight:
    """How a plant without a simulated world sees its target.

    camera: the true one. target: in the world. rate: pictures a second.
    pictures: draw them; otherwise outlines and corners are exact.
    grey_noise: standard deviation of drawn pixels, grey levels. jitter: of exact points, px.
    depth: deliver a depth image too. drop: probability that an image is lost.
    occluder: corners (x, y), m, of a white rectangle on the target. occluded: from when and until
        when it lies there, s; None: always.
    unbounded: exact features have no picture's border, and are lost behind the camera alone.
    name: of the camera. place: of another camera than the control camera.
    parts: rows that are exposed one after the other; empty: all at once.
    sensor: adds a calibrated sensor's noise to drawn pictures; None: there is none.
    """

    camera: CameraModel
    target: PlacedTarget
    rate: float = 30.0
    pictures: bool = False
    grey_noise: float = 0.0
    jitter: float = 0.0
    depth: bool = False
    drop: float = 0.0
    occluder: tuple[tuple[float, float], tuple[float, float]] | None = None
    occluded: tuple[tuple[float, float], ...] | None = None
    unbounded: bool = False
    name: str = CAMERA
    place: Place | None = None
    parts: tuple[RowBand, ...] = ()
    sensor: EffectChain | None = None

    def look(self, pose: np.ndarray, stamp_ns: int, random: np.random.Generator) -> CameraReading:
        """What the camera sees where the control camera is at world_T_camera (4, 4)."""
        seen_from = self.seen_from(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
            points = self.target.shape.points(seen_from)
        except ViewError:
            outline = points = None
        if not self.pictures:
            if outline is None or not (
                self.unbounded or cameras.in_view(outline, self.camera, 0.0)
            ):
                return CameraReading(stamp_ns, camera=self.name)
            return CameraReading(
                stamp_ns,
                outline=self.jittered(self.pixels(outline), random, closed=True),
                points=self.jittered(self.pixels(points), random),
                camera=self.name,
            )
        drawn = self._drawn(outline, seen_from, lies_there(self.occluded, stamp_ns / NS))
        image = self.noisy(drawn, stamp_ns, random)
        depth = self._depth(seen_from) if self.depth else None
        return CameraReading(stamp_ns, image, "mono8", depth, camera=self.name)

    def noisy(
        self, image: np.ndarray, stamp_ns: int, random: np.random.Generator
    ) -> np.ndarray:
        """A drawn picture (rows, columns) uint8 with its noise."""
        if self.sensor is not None:
            image = self.sensor.apply(image, stamp_ns)
        if self.grey_noise:
            noise = image + random.normal(0.0, self.grey_noise, image.shape)
            image = np.clip(np.round(noise), 0, 255).astype(np.uint8)
        return image

    def jittered(
        self, pixels: np.ndarray | None, random: np.random.Generator, closed: bool = False
    ) -> np.ndarray | None:
        """Pixels (n, 2) with their noise; that of an outline, closed, is drawn anew where edges
        cross, as no picture's do."""
        if pixels is None or not self.jitter:
            return pixels
        for _ in range(TRIES):
            found = pixels + random.normal(0.0, self.jitter, pixels.shape)
            if not closed or find_crossing(found) is None:
                break
        return found

    def seen_from(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """target_T_camera (4, 4) where the control camera is at world_T_camera (4, 4)."""
        at = pose if self.place is None else self.place.at(pose)
        return self.target.seen_from(at, stamp_ns / NS)

    def pixels(self, points: np.ndarray | None) -> np.ndarray | None:
        """Where normalised points (n, 2) are in the picture, px."""
        return None if points is None else np.column_stack(self.camera.project(*points.T))

    def _drawn(
        self, outline: np.ndarray | None, seen_from: np.ndarray, occluded: bool
    ) -> np.ndarray:
        """The picture (rows, columns) uint8; `occluded`: with what lies on the target."""
        shape, occluder = self.target.shape, self.occluder if occluded else None
        if isinstance(shape, TexturedTarget | SolidTarget):
            return seen(shape, self.camera, seen_from, occluder)
        image = cameras.draw(outline, self.camera)
        if outline is not None and occluder is not None:
            (x0, y0), (x1, y1) = occluder
            corners = np.array([(x, y, shape.height) for x, y in (
                (x0, y0), (x1, y0), (x1, y1), (x0, y1))])  # fmt: skip
            with contextlib.suppress(ViewError):
                covered = cameras.draw(project(corners, seen_from), self.camera)
                image = np.where(covered < OCCLUDED, np.uint8(cameras.WHITE), image)
        return image

    def _depth(self, target_T_camera: np.ndarray) -> np.ndarray:
        """(rows, columns) m of the plane that the target lies in; inf where it is not before."""
        a, b, c = self.target.shape.plane(target_T_camera)
        u, v = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        x, y, valid = self.camera.normalise(u.ravel(), v.ravel())
        nearness = a * x + b * y + c
        depth = np.full(nearness.shape, np.inf, np.float32)
        before = valid & (nearness > 0.0)
        depth[before] = 1.0 / nearness[before]
        return depth.reshape(self.camera.height, self.camera.width)


def lies_there(times: tuple[tuple[float, float], ...] | None, time: float) -> bool:
    """Whether what comes and goes is there at a time (s): after its coming, up to its going."""
    return times is None or any(begin < time <= end for begin, end in times)


class Exposures:
    """When a camera exposes, from its first period on, and what it sees then.

    Attributes:
        due_ns: simulated time at which it has to be asked next: of an exposure, or of its part.
    """

    def __init__(self, sight: Sight, random: np.random.Generator) -> None:
        """`random`: draws its noise, and which images are lost."""
        self._sight, self._random, self._count = sight, random, 1
        self._period = NS / sight.rate
        self._offsets = [part.offset_ns for part in sight.parts] or [0]
        self._poses: list[np.ndarray] = []
        self.due_ns = self._stamp_ns + self._offsets[0]

    @property
    def _stamp_ns(self) -> int:
        return round(self._count * self._period)

    def expose(self, pose: np.ndarray) -> CameraReading | None:
        """Where the control camera is at world_T_camera (4, 4); None: the image is lost, or not
        whole yet."""
        at_ns, poses = self._stamp_ns, [*self._poses, pose]
        whole = len(poses) == len(self._offsets)
        self._poses, self._count = [] if whole else poses, self._count + whole
        self.due_ns = self._stamp_ns + self._offsets[len(self._poses)]
        if not whole or self._sight.drop and self._random.random() < self._sight.drop:
            return None
        if self._sight.parts:
            return rolling(self._sight, poses, at_ns, self._random)
        return self._sight.look(pose, at_ns, self._random)


def exposures(
    sight: Sight, others: Sequence[Sight], random: np.random.Generator, seed: int
) -> list[Exposures]:
    """Those of the control camera, whose chance is `random`, and of the other cameras."""
    return [Exposures(sight, random)] + [
        Exposures(other, np.random.default_rng((seed, i))) for i, other in enumerate(others)
    ]


class KinematicPlant(Plant):
    """Coordinates that follow their commands; what chain and free camera share."""

    outputs = frozenset(("position", "velocity"))

    def __init__(
        self,
        arm: Arm | FreeBody,
        q: np.ndarray,
        sight: Sight,
        joint_rate: float = 100.0,
        lag: float = 0.0,
        seed: int = 0,
        others: Sequence[Sight] = (),
    ) -> None:
        """Stand at joints q (n,).

        Args:
            sight: of the control camera. others: of the other cameras.
            joint_rate: joint states a second. lag: time constant of every joint, s.
        """
        self.arm, self.sight, self.camera = arm, sight, sight.camera
        self.joint_names = tuple(arm.names)
        self._random = np.random.default_rng(seed)
        self._exposures = exposures(sight, others, self._random, seed)
        self._image_ns = min(one.due_ns for one in self._exposures)
        self._lag = lag
        self._time_ns = 0
        self._q = np.array(q, float)
        self._speed = np.zeros_like(self._q)
        self._kind, self._asked = "position", self._q.copy()
        self._joint_period, self._samples = NS / joint_rate, 0

    @property
    def time_ns(self) -> int:
        """Simulated time, ns."""
        return self._time_ns

    def advance(self, until_ns: int) -> list[Reading]:
        """Go to the next measurement, or to `until_ns` if none comes before."""
        joints_ns = JOINT_PHASE_NS + round(self._samples * self._joint_period)
        time_ns = min(joints_ns, self._image_ns, until_ns)
        if time_ns > self._time_ns:
            self._move((time_ns - self._time_ns) / NS)
            self._time_ns = time_ns
        readings: list[Reading] = []
        if joints_ns == time_ns:
            self._samples += 1
            q, speed = self.joints()
            readings.append(JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()))
        if self._image_ns == time_ns:
            for one in self._exposures:
                if one.due_ns == time_ns and (seen := one.expose(self.pose())) is not None:
                    readings.append(seen)
            self._image_ns = min(one.due_ns for one in self._exposures)
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command positions or velocities of all joints."""
        values = np.array(values, float)
        if kind not in self.outputs:
            raise ExperimentError(
                f"this plant takes {' or '.join(sorted(self.outputs))} commands, not {kind}"
            )
        if values.shape != self._q.shape or not np.isfinite(values).all():
            raise ExperimentError(
                f"a command of {len(self._q)} finite numbers is needed, got {values}"
            )
        self._taken(kind, values)

    def pose(self) -> np.ndarray:
        """world_T_camera (4, 4)."""
        return self.arm.pose(self._q)

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.poses."""
        return np.array([self.arm.pose(q) for q in positions]).reshape(-1, 4, 4)

    def places(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.places."""
        arm = self.arm
        return arm.places(positions) if isinstance(arm, Arm) else super().places(positions)

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities now."""
        return self._q.copy(), self._speed.copy()

    def _taken(self, kind: str, values: np.ndarray) -> None:
        """Follow a command (n,) from now on."""
        self._kind, self._asked = kind, values if kind == "position" else self._motion(values)

    def _move(self, dt: float) -> None:
        """Solve the lag over dt (s), exactly."""
        rest = np.exp(-dt / self._lag) if self._lag > 0.0 else 0.0
        before = self._q
        if self._kind == "position":
            self._q = self._limited(self._asked + rest * (before - self._asked))
            self._speed = self._motion((self._q - before) / dt)
            return
        moved = self._asked * dt + (self._speed - self._asked) * self._lag * (1.0 - rest)
        self._speed = self._asked + rest * (self._speed - self._asked)
        self._displace(moved)

    def _motion(self, rates: np.ndarray) -> np.ndarray:
        """What is kept of coordinate rates (n,): that which a lag acts on."""
        return rates

    def _limited(self, q: np.ndarray) -> np.ndarray:
        """The coordinates nearest to q that the plant can have."""
        return q

    def _displace(self, moved: np.ndarray) -> None:
        """Add a motion, what `_motion` gives times seconds, to the coordinates."""
        self._q = self._q + moved


class KinematicChain(KinematicPlant):
    """An arm without dynamics: each joint lags behind its command, within its limits."""

    arm: Arm

    def _limited(self, q: np.ndarray) -> np.ndarray:
        return np.clip(q, self.arm.lower, self.arm.upper)

    def _displace(self, moved: np.ndarray) -> None:
        free = self._q + moved
        self._q = self._limited(free)
        self._speed = np.where(self._q == free, self._speed, 0.0)


class FreeCamera(KinematicPlant):
    """A camera that flies as it is told: velocities are a twist, which moves it by its exponential.

    So a constant twist takes it to the same pose in one step as in a thousand.
    """

    arm: FreeBody

    def __init__(
        self, arm: FreeBody, q: np.ndarray, sight: Sight, **further: float | int
    ) -> None:
        """Stand at coordinates q (6,); `further`: see KinematicPlant."""
        super().__init__(arm, q, sight, **further)
        self._pose = arm.pose(self._q)

    def pose(self) -> np.ndarray:
        """world_T_camera (4, 4)."""
        return self._pose.copy()

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and their rates now."""
        return self._q.copy(), np.linalg.solve(self.arm.jacobian(self._q), self._speed)

    def _motion(self, rates: np.ndarray) -> np.ndarray:
        return self.arm.jacobian(self._q) @ rates

    def _limited(self, q: np.ndarray) -> np.ndarray:
        self._pose = self.arm.pose(q)
        return q

    def _displace(self, moved: np.ndarray) -> None:
        self._pose = self._pose @ exponential(moved)
        self._q = self.arm.coordinates(self._pose)
