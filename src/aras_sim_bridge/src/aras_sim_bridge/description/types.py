"""Dataclasses of a robot description; lengths are in m, angles in rad, and rotations rpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

from aras_sim_bridge.description.camera_types import CameraDescription
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.urdf import ZERO, FramedElement, Joint
from aras_visual_servo_base.urdf import Rgba as Rgba


@dataclass(frozen=True)
class Geometry:
    """A shape.

    Attributes:
        kind: box, cylinder, sphere, capsule, mesh or plane.
        size: side lengths of a box, m.
        radius, length: size of a cylinder or capsule, whose axis is z, or of a sphere, m.
        filename: absolute path of a mesh file.
        scale: scale factors of a mesh.
        submesh: name of the part of the mesh file that is used; '' for the whole file.
        is_centred: whether the middle of the submesh's bounding box is moved to the origin.
        normal: normal of a plane.
    """

    kind: str
    size: Vector3 = ZERO
    radius: float = 0.0
    length: float = 0.0
    filename: str = ""
    scale: Vector3 = (1.0, 1.0, 1.0)
    submesh: str = ""
    is_centred: bool = False
    normal: Vector3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Visual(FramedElement):
    """A visible shape of a link, whose colour is in `RobotDescription.colours`.

    Attributes:
        texture: path of the image that its material script names; '' if there is none.
    """

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry
    texture: str = ""


@dataclass(frozen=True)
class Collision(FramedElement):
    """A shape for collision detection."""

    name: str
    origin_xyz: Vector3
    origin_rpy: Vector3
    geometry: Geometry


@dataclass(frozen=True)
class Inertial(FramedElement):
    """Mass (kg), pose of the inertial frame in the link frame, and inertia tensor (kg m²).

    Attributes:
        inertia: (ixx, ixy, ixz, iyy, iyz, izz) about the centre of mass, in the axes of the
            inertial frame.
    """

    mass: float
    origin_xyz: Vector3
    origin_rpy: Vector3
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Link:
    """A rigid body.

    Attributes:
        gravity: whether gravity acts on the link (`<gravity>` or `<turnGravityOff>`).
        kinematic: value of `<kinematic>`.
        mu: Coulomb friction coefficient of contacts.
        bounce: (coefficient of restitution, speed in m/s below which contacts do not bounce), or
            None if the description does not give them.
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
    """One `<transmission>` of a URDF, whose content has not been checked.

    Attributes:
        joints, interfaces: all joints and hardware interfaces of the transmission.
        joint, interface: the first joint and the first interface; '' if there is none.
    """

    name: str
    type: str
    joint: str
    interface: str
    has_actuator: bool
    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()


@dataclass(frozen=True)
class ControlPlugin:
    """`<plugin filename="libgazebo_ros_control.so">`; a missing element is None."""

    robot_namespace: str | None = None
    control_period: float | None = None
    e_stop_topic: str | None = None


@dataclass(frozen=True)
class ChannelNoise:
    """Gaussian noise of one sensor channel, in the unit of the channel.

    The bias is drawn once for each sensor; its sign is random.
    """

    mean: float = 0.0
    stddev: float = 0.0
    bias_mean: float = 0.0
    bias_stddev: float = 0.0


@dataclass(frozen=True)
class SensorDescription:
    """Settings of a motion or force sensor, read from its plug-in and its `<sensor>`.

    Attributes:
        kind: pose (libgazebo_ros_p3d.so), imu (libgazebo_ros_imu_sensor.so), body_imu
            (libgazebo_ros_imu.so), wrench, contact or joint_states.
        namespace: namespace of the topic; None means the name of the model.
        frame: frame of the messages; '' means the frame of the link.
        rate: messages per second of simulated time; 0 means one message in each physics step.
        link: link that a pose sensor or IMU measures, or the child of a wrench sensor's joint.
        pose: (xyz, rpy) of an IMU in its link, or of a wrench sensor in its joint.
        offset: (xyz, rpy) added to the measurement.
        noise: standard deviation of all channels.
        sample_rate: sampling rate, Hz; an IMU reports the mean acceleration over one sampling
            period. 0 means one physics step.
        from_start: whether an IMU's orientation is relative to its initial orientation.
        channels: noise of an IMU's three angular velocities and three accelerations, or of a
            wrench's three forces and three torques; () means no noise.
        collisions: names of the collisions whose contacts are reported.
        joints: joints whose states are published.
        joint: joint whose wrench is measured.
        wrench_frame: frame of the wrench: child, parent or sensor.
        on_child: whether to report the wrench of the parent on the child instead of that of the
            child on the parent.
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
class GripperDescription:
    """A gripper: `fingers` are the links that touch an object, which is then fixed to `palm`."""

    name: str
    palm: str
    fingers: tuple[str, ...]


@dataclass(frozen=True)
class GraspFixPlugin:
    """Settings of libgazebo_grasp_fix.so.

    Attributes:
        angle: smallest angle between two opposing forces, rad.
        rate: contact checks per second of simulated time.
        most: largest value of the contact counter of an object.
        threshold: value of this counter above which the object is grasped.
        release_tolerance: distance, m, that a finger may move relative to its contact before the
            object is released.
        collides: whether a grasped object still collides with other bodies.
    """

    arms: tuple[GripperDescription, ...]
    angle: float
    rate: float
    most: int
    threshold: int
    release_tolerance: float
    collides: bool


@dataclass(frozen=True)
class LinkAttacherPlugin:
    """The world plug-in libgazebo_ros_link_attacher.so."""


def is_present(intervals: tuple[tuple[float, float], ...] | None, time: float) -> bool:
    """Return whether an object is present at `time` s.

    It is present in each of the intervals (begin, end], s, or always if these are None.
    """
    return intervals is None or any(begin < time <= end for begin, end in intervals)


@dataclass(frozen=True)
class Light(FramedElement):
    """A light of an SDF world.

    Attributes:
        kind: directional, point or spot.
        direction: direction in which the light shines; in the light's own frame for a spot, in the
            world frame for other lights.
        attenuation_constant, attenuation_linear, attenuation_quadratic: coefficients a, b and c of
            the attenuation 1 / (a + b d + c d²) at the distance d, m.
        attenuation_range: distance, m, beyond which the light has no effect.
        spot_inner, spot_outer: full opening angles of a spot's cones, rad.
        lit_intervals: (begin, end) of each interval of simulated time, s, in which the light is on;
            None means always.
    """

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


# The directional light of Gazebo's model `sun`.
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9))
SHADOWS = ("none", "hard", "soft")


@dataclass(frozen=True)
class SceneSettings:
    """A world's `<scene>`.

    Attributes:
        ambient: colour of the ambient light.
        background: colour of the background.
        sky: whether a sky is drawn instead of the background colour.
        shadows: shadows in camera images: none, hard or soft.
    """

    ambient: Rgba = (0.4, 0.4, 0.4, 1.0)
    background: Rgba = (0.7, 0.7, 0.7, 1.0)
    sky: bool = False
    shadows: str = "none"


@dataclass(frozen=True)
class LoopJoint:
    """A joint that closes a kinematic chain, and the poses of its frame in its two links.

    The fields `origin_xyz` and `origin_rpy` of the joint are not used.
    """

    joint: Joint
    in_parent: Pose
    in_child: Pose


@dataclass(frozen=True)
class RobotDescription:
    """Description of a model. Its mappings are read-only and have the order of the file.

    Attributes:
        colours: rgba of each link in camera images, from its Gazebo material ('Gazebo/Black') or
            its SDF visuals; a link without an entry is drawn white.
        static: whether the model never moves (`<gazebo><static>true`).
        warnings: one sentence for each part that was repaired or ignored, for the caller to log.
        initial_pose: pose (xyz, rpy) that an SDF file gives.
        initial_joints: positions (rad or m) of the joints in a world's `<state>`.
        loops: joints that close chains of the tree.
        parts: descriptions of the model's other trees, which no joint connects to the first tree;
            the `initial_pose` of each is relative to the model.
    """

    name: str
    root: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    transmissions: tuple[Transmission, ...] = ()
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    sensors: tuple[SensorDescription, ...] = ()
    grasps: tuple[GraspFixPlugin, ...] = ()
    colours: Mapping[str, Rgba] = field(default_factory=lambda: MappingProxyType({}))
    static: bool = False
    warnings: tuple[str, ...] = ()
    initial_pose: tuple[Vector3, Vector3] = (ZERO, ZERO)
    initial_joints: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    loops: tuple[LoopJoint, ...] = ()
    parts: tuple[RobotDescription, ...] = ()

    def list_moving_joints(self) -> tuple[str, ...]:
        """Return the names of the joints with a degree of freedom, in file order."""
        return tuple(name for name, joint in self.joints.items() if joint.is_movable)

    def list_child_joints(self, link: str) -> list[Joint]:
        """Return the joints whose parent is `link`, in file order."""
        return self._child_joints.get(link, [])

    @cached_property
    def _child_joints(self) -> dict[str, list[Joint]]:
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        return children
