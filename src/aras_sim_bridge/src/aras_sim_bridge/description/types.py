"""The dataclasses of a robot description. SI units, radians; rotations as rpy, as in URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.settings import parameter
from aras_visual_servo_base.urdf import ZERO, FramedElement, Joint
from aras_visual_servo_base.urdf import Rgba as Rgba


@dataclass(frozen=True)
class Geometry:
    """A shape. `kind` is box, cylinder, sphere, capsule, mesh or plane.

    size: full extents of a box (m). radius, length: of cylinder, sphere and capsule (axis along z).
    filename: absolute path of a mesh; scale: its factors. normal: of a plane.
    """

    kind: str
    size: Vector3 = ZERO
    radius: float = 0.0
    length: float = 0.0
    filename: str = ""
    scale: Vector3 = (1.0, 1.0, 1.0)
    normal: Vector3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Visual(FramedElement):
    """What a camera sees of a link. Its colour is the link's: `RobotDescription.colours`.
    texture: path of a picture that a material script puts on it, '' for none."""

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry
    texture: str = ""


@dataclass(frozen=True)
class Collision(FramedElement):
    """What touches."""

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry


@dataclass(frozen=True)
class Inertial(FramedElement):
    """Mass (kg), centre of mass frame in the link frame, inertia about it (kg m²).

    inertia: (ixx, ixy, ixz, iyy, iyz, izz) in the axes of the inertial frame.
    """

    mass: float
    origin_xyz: Vector3
    origin_rpy: Vector3
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Link:
    """A rigid body. gravity and kinematic come from `<gazebo reference>` (`<gravity>`,
    `<turnGravityOff>`, `<kinematic>`); mu is its Coulomb contact friction.

    bounce: coefficient of restitution, and the m/s below which it does not act; None: not given.
    """

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...] = ()
    collisions: tuple[Collision, ...] = ()
    gravity: bool = True
    kinematic: bool = False
    mu: float | None = None
    bounce: tuple[float, float] | None = None


@dataclass(frozen=True)
class Transmission:
    """One `<transmission>` as written: several joints or interfaces give several entries in the
    tuples; `joint` and `interface` are the first ones ('' where there is none)."""

    name: str
    type: str
    joint: str
    interface: str
    has_actuator: bool
    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()


@dataclass(frozen=True)
class ControlPlugin:
    """`<plugin filename="libgazebo_ros_control.so">`; None where the element is absent."""

    robot_namespace: str | None = None
    control_period: float | None = None
    e_stop_topic: str | None = None


@dataclass(frozen=True)
class Noise:
    """Per pixel noise of a camera, in units of full scale (1.0 = 255)."""

    kind: str = "none"
    mean: float = 0.0
    stddev: float = 0.0


@dataclass(frozen=True)
class LensDescription:
    """`<lens>`: of a wideanglecamera its projection; of others `<intrinsics>` (fx, fy, cx, cy), px,
    the principal point from the image's corner, or None."""

    kind: str = "gnomonical"
    scale_to_hfov: bool = True
    cutoff_angle: float = 1.5707963267948966
    intrinsics: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class DepthTopics:
    """How a depth camera delivers depth, below its name.

    image, info, points: topics; points '' for no point clouds.
    nearest, farthest: m; depths that are not between them are NaN, and 0 in millimetres.
    millimetres: 16UC1 in place of 32FC1. rows: whether a cloud has the picture's rows, or one.
    """

    image: str = "depth/image_raw"
    info: str = "depth/camera_info"
    points: str = ""
    nearest: float = parameter(0.0, "m", least=0.0)
    farthest: float = parameter(math.inf, "m", above=0.0, infinite=True)
    millimetres: bool = False
    rows: bool = True


@dataclass(frozen=True)
class CameraPlugin:
    """A camera's plug-in, with the defaults of `libgazebo_ros_camera.so`; distortion is
    (k1, k2, k3, t1, t2). trigger_topic: '' for a camera that streams. depth: of depth cameras."""

    robot_namespace: str = ""
    camera_name: str = ""
    image_topic: str = "image_raw"
    info_topic: str = "camera_info"
    frame_name: str = ""
    update_rate: float = 0.0
    hack_baseline: float = 0.0
    cx: float = 0.0
    cy: float = 0.0
    focal_length: float = 0.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    auto_distortion: bool = False
    trigger_topic: str = ""
    depth: DepthTopics | None = None


@dataclass(frozen=True)
class CameraDescription:
    """A camera sensor on a link. pose: (xyz, rpy) in the link, looking along its +x, z up.

    kind: camera, depth or wideanglecamera. distortion: the sensor's (k1, k2, k3, p1, p2), None
    without a `<distortion>` element; distortion_center in image fractions.
    shutter: cameras of one model with the same one expose together; '' for a camera by itself.
    """

    name: str
    link: str
    pose: tuple[Vector3, Vector3]
    kind: str
    update_rate: float
    horizontal_fov: float
    width: int
    height: int
    format: str
    near: float
    far: float
    noise: Noise = field(default_factory=Noise)
    distortion: tuple[float, float, float, float, float] | None = None
    distortion_center: tuple[float, float] = (0.5, 0.5)
    lens: LensDescription | None = None
    plugin: CameraPlugin | None = None
    shutter: str = ""


@dataclass(frozen=True)
class ChannelNoise:
    """Gaussian noise of one number that a sensor tells, in its unit; the bias is drawn once, its
    sign by chance."""

    mean: float = 0.0
    stddev: float = 0.0
    bias_mean: float = 0.0
    bias_stddev: float = 0.0


@dataclass(frozen=True)
class SensorDescription:
    """A sensor of motion or forces, as its plug-in and its `<sensor>` ask for it.

    kind: pose (p3d), imu (in a sensor), body_imu (libgazebo_ros_imu.so), wrench or contact.
    namespace: None is the model's name. frame: '' is that of the link. rate: readings a second of
    simulated time, 0 for one a step.
    link: what a pose and IMUs are of, the child of a wrench's joint; pose: (xyz, rpy) of an IMU in
    it, of a wrench's sensor in the joint.
    offset: (xyz, rpy) added to what is told. noise: stddev of all channels.
    sample_rate: Hz; an IMU's acceleration is the mean over such a period, 0 for a step.
    from_start: whether an IMU's orientation is told from that at its start.
    channels: three of turning and three of moving of an IMU, three forces and three torques of a
    wrench, or none.
    collisions: names of the collisions whose contacts are told.
    joints: whose states are published.
    joint: what a wrench is of. measured_in: child, parent or sensor; on_child: whether the wrench
    is what the parent does to the child, or the other way round.
    """

    kind: str
    topic: str
    namespace: str | None = ""
    frame: str = ""
    rate: float = 0.0
    link: str = ""
    pose: tuple[Vector3, Vector3] = (ZERO, ZERO)
    offset: tuple[Vector3, Vector3] = (ZERO, ZERO)
    noise: float = 0.0
    sample_rate: float = 0.0
    from_start: bool = False
    channels: tuple[ChannelNoise, ...] = ()
    collisions: tuple[str, ...] = ()
    joint: str = ""
    wrench_frame: str = "child"
    on_child: bool = False
    joints: tuple[str, ...] = ()


@dataclass(frozen=True)
class GraspArm:
    """A gripper: what it grasps is held by the link `palm`; `fingers` are the links that touch."""

    name: str
    palm: str
    fingers: tuple[str, ...]


@dataclass(frozen=True)
class GraspDescription:
    """libgazebo_grasp_fix.so. angle: rad, from which on two forces are opposed. rate: Hz of
    simulated time, of its counts. most, threshold: the greatest count, and the one beyond which a
    thing is held. release_tolerance: m, that a finger may move from where it touched. collides:
    whether what is held touches anything."""

    arms: tuple[GraspArm, ...]
    angle: float
    rate: float
    most: int
    threshold: int
    release_tolerance: float
    collides: bool


@dataclass(frozen=True)
class LinkAttacher:
    """libgazebo_ros_link_attacher.so of a world."""


def is_present(intervals: tuple[tuple[float, float], ...] | None, time: float) -> bool:
    """Whether what comes and goes at given times, s, is there at `time`: after its coming, up to
    its going. None: it always is."""
    return intervals is None or any(begin < time <= end for begin, end in intervals)


@dataclass(frozen=True)
class Light(FramedElement):
    """A light of an SDF world. kind: directional, point or spot. direction: from the light,
    in the world, of a spot in its own frame. attenuation: by the distance in m, none beyond
    attenuation_range. spot_inner, spot_outer: whole angles of a spot's cones, rad. shines: from
    when and until when, s of simulated time, as often as it comes; None: always."""

    name: str
    kind: str = "directional"
    origin_xyz: Vector3 = (0.0, 0.0, 10.0)
    origin_rpy: Vector3 = ZERO
    diffuse: Rgba = (0.8, 0.8, 0.8, 1.0)
    specular: Rgba = (0.2, 0.2, 0.2, 1.0)
    direction: Vector3 = (-0.4834, 0.0967, -0.8701)
    attenuation_constant: float = 0.9
    attenuation_linear: float = 0.01
    attenuation_quadratic: float = 0.001
    attenuation_range: float = 1000.0
    spot_inner: float = 0.6
    spot_outer: float = 1.0
    spot_falloff: float = 1.0
    cast_shadows: bool = False
    lit_intervals: tuple[tuple[float, float], ...] | None = None


# Gazebo's models/sun.
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9))
SHADOWS = ("none", "hard", "soft")


@dataclass(frozen=True)
class SceneSettings:
    """A world's `<scene>`: ambient light, what is seen where nothing is (a colour, or a sky), and
    shadows in pictures: none, hard or soft."""

    ambient: Rgba = (0.4, 0.4, 0.4, 1.0)
    background: Rgba = (0.7, 0.7, 0.7, 1.0)
    sky: bool = False
    shadows: str = "none"


@dataclass(frozen=True)
class LoopJoint:
    """A joint that closes a chain of a tree: its frame in both of the links that it joins.

    The joint's own `origin_*` mean nothing.
    """

    joint: Joint
    in_parent: Pose
    in_child: Pose


@dataclass(frozen=True)
class RobotDescription:
    """A whole model. Mappings keep file order and are read-only.

    colours: link -> rgba that cameras see: that of its Gazebo material ('Gazebo/Black'), or in SDF
    that of its visuals; a link without one is drawn white.
    static: the model never moves (`<gazebo><static>true`). warnings: what was repaired or ignored
    while reading, one sentence each, for the caller to log.
    initial_pose: (xyz, rpy) written in the file (SDF only). initial_joints: rad or m at which a
    world's <state> has joints.
    loops: joints that close chains of the tree. parts: what of the model no joint holds to it, each
    a tree of its own that stands at its `initial_pose` in the model.
    """

    name: str
    root: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    transmissions: tuple[Transmission, ...] = ()
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    sensors: tuple[SensorDescription, ...] = ()
    grasps: tuple[GraspDescription, ...] = ()
    colours: Mapping[str, Rgba] = field(default_factory=lambda: MappingProxyType({}))
    static: bool = False
    warnings: tuple[str, ...] = ()
    initial_pose: tuple[Vector3, Vector3] = (ZERO, ZERO)
    initial_joints: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    loops: tuple[LoopJoint, ...] = ()
    parts: tuple[RobotDescription, ...] = ()

    def list_moving_joints(self) -> tuple[str, ...]:
        """Names of the joints with a degree of freedom, in file order."""
        return tuple(name for name, joint in self.joints.items() if joint.is_movable)
