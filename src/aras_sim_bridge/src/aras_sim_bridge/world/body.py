"""A description brought into Bullet: the body, its numbering, its dynamics."""

import math

from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import bullet_files
from aras_sim_bridge.world.bullet import pybullet
from aras_visual_servo_base.poses import IDENTITY, Pose

DEFAULT_FRICTION = 1.0  # Gazebo's
_UNBOUNDED_VELOCITY = 1e9  # Bullet would cut joint velocities at 100 rad/s
# m, by which Bullet makes the hulls of meshes larger. A root's is what it lets bodies
# that rest sink in by, so that they stand at their own height; of links it does not let it be set.
LINK_MARGIN = 1e-3
ROOT_MARGIN = 1e-5


class Body:
    """What Bullet holds of a model: its body, the numbers of its parts, and their dynamics.

    Attributes:
        body_id: Bullet's, another one after each load.
        links: Bullet's index by link; -1 is the root.
        joint_indices: Bullet's index by joint.
        inertial_poses: link_T_principal, Bullet's frame of a link, by link.
        asleep: whether Bullet's steps leave it alone.
        weightless: mass of the links that gravity does not pull at, kg.
        friction: contact friction coefficient by Bullet's index of the link.
    """

    def __init__(self, client: int, name: str, fixed_base: bool) -> None:
        self.client = client
        self.name = name
        self.fixed_base = fixed_base
        self.body_id = -1
        self.is_asleep = False

    def load(self, description: RobotDescription, pose: Pose) -> None:
        """Bring a description into Bullet with its root at `pose`, at rest.

        Raises:
            WorldError: Bullet cannot load it.
        """
        bodies = bullet_files.give_root_mass(description)
        window = pybullet.getConnectionInfo(self.client)["connectionMethod"] == pybullet.GUI
        with bullet_files.BulletFiles(bodies, self.fixed_base, window) as files:
            self._draw(window, False)  # else a frame for each shape
            try:
                self.body_id = pybullet.loadURDF(
                    files.urdf, pose.xyz, pose.quat, useFixedBase=self.fixed_base,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE
                    | pybullet.URDF_USE_IMPLICIT_CYLINDER,  # else prisms, which do not roll
                    physicsClientId=self.client)
            except pybullet.error as error:
                raise WorldError(
                    f"model '{self.name}': Bullet cannot load it ({error}); check its mesh files"
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
        """Take the body out of Bullet."""
        pybullet.removeBody(self.body_id, physicsClientId=self.client)

    def set_asleep(self, asleep: bool) -> None:
        """Let Bullet's steps leave the body alone, or move it again from the next but one on."""
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
                continue  # Bullet's first link, see bullet_file.py
            joints[info[1].decode()] = index
            links[info[12].decode()] = index
        missing = set(description.links) - set(links)
        if missing:
            raise WorldError(f"model '{self.name}': Bullet lost the links {sorted(missing)}")
        self.links, self.joint_indices = links, joints
        coefficients = {links[name]: link.mu for name, link in description.links.items()}
        self.friction = {index: DEFAULT_FRICTION if mu is None else mu
                         for index, mu in coefficients.items()}

    def _set_dynamics(self, bodies: RobotDescription) -> None:
        """No hidden forces: Bullet's motors, damping and velocity bound off, ours on."""
        client, body = self.client, self.body_id
        # Of the whole body: with one of these in it, PyBullet applies a link's call to the root.
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
                # Bullet zeroes tensors that break the triangle inequality: say it again.
                settings["localInertiaDiagonal"] = bullet_files.find_principal_frame(link.inertial)[
                    1
                ]
            pybullet.changeDynamics(body, index, physicsClientId=client, **settings)


def _find_gripping_links(description: RobotDescription) -> set[str]:
    """Links that may hold something by friction: those that a joint with stops moves. Bullet keeps
    in place what they hold; it creeps by a millimetre in ten seconds else, for the sweeps of the
    solver end early. Wheels have no stops, and would gain speed by it."""
    above = {joint.child: joint for joint in description.joints.values()}
    found = set()
    for link in above:
        joint = above[link]
        while not joint.is_movable and joint.parent in above:
            joint = above[joint.parent]
        if joint.is_movable and math.isfinite(sum(joint.stops)):
            found.add(link)
    return found
