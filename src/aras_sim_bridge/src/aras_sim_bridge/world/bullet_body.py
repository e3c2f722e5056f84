"""The body of a model in Bullet: how it is loaded, its indices, and its dynamics parameters."""

import math

from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import bullet_files
from aras_sim_bridge.world.bullet import pybullet
from aras_visual_servo_base.poses import IDENTITY, Pose

DEFAULT_FRICTION = 1.0  # Gazebo's default friction coefficient of a link
# Joint velocity limit in Bullet that has no effect, rad/s or m/s. Bullet's default would be 100
# rad/s.
_UNBOUNDED_VELOCITY = 1e9
# Bullet's collision margins, m: ROOT_MARGIN for a root link, LINK_MARGIN for all other links.
# Bullet enlarges the convex hulls of meshes by this margin. ROOT_MARGIN is small, because a body at
# rest sinks into the ground by it. PyBullet cannot change LINK_MARGIN.
LINK_MARGIN = 1e-3
ROOT_MARGIN = 1e-5


class BulletBody:
    """Body of one model in Bullet, with the indices of its links and joints.

    Attributes:
        body_id: Bullet's body id; it changes with each load.
        links: Bullet's link index by link name; -1 is the root.
        joint_indices: Bullet's joint index by joint name.
        inertial_poses: pose of the principal axes of inertia in the frame of each link, by link
            name. Bullet uses the frame of the principal axes as its link frame.
        is_asleep: whether the body is asleep, so that Bullet's steps do not move it.
        weightless_link_masses: masses of the links that gravity does not act on, kg.
        friction: contact friction coefficient by Bullet's link index.
    """

    def __init__(self, client: int, name: str, fixed_base: bool) -> None:
        self.client = client
        self.name = name
        self.fixed_base = fixed_base
        self.body_id = -1
        self.is_asleep = False

    def load(self, description: RobotDescription, pose: Pose) -> None:
        """Load a description into Bullet, at rest, with its root at `pose`.

        Raises:
            WorldError: Bullet cannot load the model.
        """
        bodies = bullet_files.give_root_mass(description)
        window = pybullet.getConnectionInfo(self.client)["connectionMethod"] == pybullet.GUI
        with bullet_files.BulletFiles(bodies, self.fixed_base, window) as files:
            self._draw(window, False)  # do not redraw the window after each shape
            try:
                self.body_id = pybullet.loadURDF(
                    files.urdf, pose.xyz, pose.quat, useFixedBase=self.fixed_base,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE
                    # Make cylinders round. Without this flag, a cylinder is a prism, which does not
                    # roll.
                    | pybullet.URDF_USE_IMPLICIT_CYLINDER,
                    physicsClientId=self.client)
            except pybullet.error as error:
                raise WorldError(
                    f"Bullet cannot load model '{self.name}' ({error}); check its mesh files"
                ) from None
            finally:
                self._draw(window, True)
        self.inertial_poses = {
            link.name: IDENTITY if link.inertial is None
            else bullet_files.find_principal_frame(link.inertial)[0]
            for link in bodies.links.values()
        }
        self.weightless_link_masses = {
            link.name: link.inertial.mass for link in bodies.links.values()
            if not link.gravity and link.inertial is not None
        }
        self.is_asleep = False
        self._read_indices(description)
        self._set_dynamics(bodies)

    def _draw(self, window: bool, on: bool) -> None:
        if window:
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, int(on),
                                              physicsClientId=self.client)

    def remove(self) -> None:
        """Remove the body from Bullet."""
        pybullet.removeBody(self.body_id, physicsClientId=self.client)

    def change_joint(self, index: int, **settings: float) -> None:
        """Change parameters of pybullet.changeDynamics for the joint with this index in Bullet."""
        pybullet.changeDynamics(self.body_id, index, physicsClientId=self.client, **settings)

    def set_velocity_motor(
        self, index: int, velocity: float, force: float, gain: float = 1.0
    ) -> None:
        """Drive a joint at `velocity` (rad/s or m/s) with at most `force` (N m or N).

        In each step, the motor removes the fraction `gain` of the difference to `velocity`. With
        the velocity 0 and the gain 1, it acts like Coulomb friction.
        """
        pybullet.setJointMotorControl2(
            self.body_id, index, pybullet.VELOCITY_CONTROL, targetVelocity=velocity, force=force,
            velocityGain=gain, physicsClientId=self.client)

    def reset_joint(self, index: int, position: float, velocity: float) -> None:
        """Set the position (rad or m) and the velocity (rad/s or m/s) of a joint."""
        pybullet.resetJointState(self.body_id, index, position, velocity,
                                 physicsClientId=self.client)

    def set_asleep(self, asleep: bool) -> None:
        """Put the body to sleep, or wake it. A woken body moves from the second step on."""
        self.is_asleep = asleep
        states = ((pybullet.ACTIVATION_STATE_ENABLE_SLEEPING,
                   pybullet.ACTIVATION_STATE_DISABLE_WAKEUP, pybullet.ACTIVATION_STATE_SLEEP)
                  if asleep else (pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
                                  pybullet.ACTIVATION_STATE_WAKE_UP))
        for state in states:
            pybullet.changeDynamics(self.body_id, -1, activationState=state,
                                    physicsClientId=self.client)

    def _read_indices(self, description: RobotDescription) -> None:
        links: dict[str, int] = {description.root: -1}
        joints: dict[str, int] = {}
        for index in range(pybullet.getNumJoints(self.body_id, physicsClientId=self.client)):
            info = pybullet.getJointInfo(self.body_id, index, physicsClientId=self.client)
            if info[1].decode() not in description.joints:
                # bullet_files.py may have added an empty link, which the description does not
                # contain
                continue
            joints[info[1].decode()] = index
            links[info[12].decode()] = index
        missing = set(description.links) - set(links)
        if missing:
            raise WorldError(f"model '{self.name}': Bullet did not load the links "
                             f"{sorted(missing)}; check their joints")
        self.links, self.joint_indices = links, joints
        coefficients = {links[name]: link.mu for name, link in description.links.items()}
        self.friction = {index: DEFAULT_FRICTION if mu is None else mu
                         for index, mu in coefficients.items()}

    def _set_dynamics(self, bodies: RobotDescription) -> None:
        """Set the dynamics parameters of the body in Bullet from its description.

        Damping, the velocity limit, restitution and rolling friction are switched off; the
        collision margin, friction anchors and principal moments of inertia are set.
        """
        client, body = self.client, self.body_id
        # Set these values once, not for each link: PyBullet applies them to the body or its root,
        # whichever link is named.
        pybullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0,
                                maxJointVelocity=_UNBOUNDED_VELOCITY, collisionMargin=ROOT_MARGIN,
                                physicsClientId=client)
        gripping = _find_gripping_links(bodies)
        for name, index in self.links.items():
            link = bodies.links[name]
            settings = {
                "jointDamping": 0.0, "frictionAnchor": int(name in gripping),
                "restitution": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0,
            }
            if link.inertial is not None and not (index == -1 and self.fixed_base):
                # Set the true principal moments. If an inertia tensor violates the triangle
                # inequality, Bullet has set its moments to zero.
                settings["localInertiaDiagonal"] = bullet_files.find_principal_frame(link.inertial)[
                    1
                ]
            pybullet.changeDynamics(body, index, physicsClientId=client, **settings)


def _find_gripping_links(description: RobotDescription) -> set[str]:
    """Return the links that may hold an object by friction: those moved by a joint with stops.

    These links get Bullet's friction anchors. Without anchors a grasped object creeps by a
    millimetre in ten seconds, because the solver stops iterating early. Wheels have no stops and
    get no anchors: anchors would make them gain speed.
    """
    parent_joints = {joint.child: joint for joint in description.joints.values()}
    found = set()
    for link in parent_joints:
        joint = parent_joints[link]
        while not joint.is_movable and joint.parent in parent_joints:
            joint = parent_joints[joint.parent]
        if joint.is_movable and math.isfinite(sum(joint.stops)):
            found.add(link)
    return found
