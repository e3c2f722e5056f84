"""A description brought into Bullet: the body, its numbering, its dynamics, its mimic gears."""

import tempfile
from collections.abc import Callable

from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.poses import IDENTITY, Pose
from aras_sim_bridge.world import bullet_file
from aras_sim_bridge.world.bullet import pybullet

DEFAULT_FRICTION = 1.0  # Gazebo's mu; Bullet multiplies the two bodies' values
NO_LIMIT_FORCE = 1e18
_UNBOUNDED_VELOCITY = 1e9  # Bullet would cut joint velocities at 100 rad/s


class LoadedModel:
    """The part of `Model` that puts its description into Bullet and takes it out again."""

    def __init__(self, client: int, description: RobotDescription, name: str, pose: Pose,
                 joint_positions: dict[str, float], fixed_base: bool,
                 gravity: tuple[float, float, float] = (0.0, 0.0, -9.8),
                 on_moved: Callable[[], None] = lambda: None) -> None:
        self.client = client
        self.on_moved = on_moved
        self.gravity = gravity
        self.name = name
        self.description = description
        self.spawn_pose = pose
        self.spawn_positions = joint_positions
        self.fixed_base = fixed_base
        self._describe(description)
        self.body_id = -1
        self._load()

    def _describe(self, description: RobotDescription) -> None:
        """Note what the description says about joints and masses."""
        self.description = description
        self.joint_names: tuple[str, ...] = (
            () if description.static else description.moving_joints()
        )
        self.link_names: tuple[str, ...] = tuple(description.links)
        self._slot = {joint: i for i, joint in enumerate(self.joint_names)}
        joints = [description.joints[j] for j in self.joint_names]
        self.damping = [j.damping for j in joints]
        self.friction = [j.friction for j in joints]
        self._limits = [
            (j.limits.lower, j.limits.upper)
            if j.limits is not None and j.limits.lower is not None else None for j in joints
        ]
        self._bodies = bullet_file.with_massive_root(description)
        self._inertial_poses = {
            link.name: IDENTITY if link.inertial is None
            else bullet_file.principal_inertial(link.inertial)[0]
            for link in self._bodies.links.values()
        }
        self._weightless = {
            link.name: link.inertial.mass for link in self._bodies.links.values()
            if not link.gravity and link.inertial is not None
        }

    def _load(self) -> None:
        """Bring the model into Bullet at its spawn pose and configuration, at rest."""
        with tempfile.TemporaryDirectory(prefix="aras_sim_bridge_") as directory:
            window = pybullet.getConnectionInfo(self.client)["connectionMethod"] == pybullet.GUI
            path = bullet_file.write(self._bodies, self.fixed_base, window, directory)
            try:
                self.body_id = pybullet.loadURDF(
                    path, self.spawn_pose.xyz, self.spawn_pose.quat, useFixedBase=self.fixed_base,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self.client)
            except pybullet.error as error:
                raise WorldError(
                    f"model '{self.name}': Bullet cannot load it ({error}); check its mesh files"
                ) from None
        self._index_links()
        self._set_dynamics()
        for joint, position in self.spawn_positions.items():
            pybullet.resetJointState(self.body_id, self._bullet_joint[self._slot[joint]], position,
                                     0.0, physicsClientId=self.client)
        self._gears = self._make_gears()

    def reload(self) -> None:
        """As `_load`, into a Bullet that was emptied; for `World.reset_simulation`."""
        self._load()

    def remove(self) -> None:
        """Take the body and its constraints out of Bullet."""
        for gear in self._gears:
            pybullet.removeConstraint(gear, physicsClientId=self.client)
        pybullet.removeBody(self.body_id, physicsClientId=self.client)

    def _index_links(self) -> None:
        links: dict[str, int] = {self.description.root: -1}
        joints: dict[str, int] = {}
        dof: dict[str, int] = {}
        for index in range(pybullet.getNumJoints(self.body_id, physicsClientId=self.client)):
            info = pybullet.getJointInfo(self.body_id, index, physicsClientId=self.client)
            joints[info[1].decode()] = index
            links[info[12].decode()] = index
            if info[3] >= 0:
                dof[info[1].decode()] = len(dof)
        missing = set(self.link_names) - set(links)
        if missing:
            raise WorldError(f"model '{self.name}': Bullet lost the links {sorted(missing)}")
        self._links = links
        self._bullet_joint = [joints[name] for name in self.joint_names]
        self.dof_order = [dof[name] for name in self.joint_names]

    def _set_dynamics(self) -> None:
        """No hidden forces: Bullet's motors, damping and velocity bound off, ours on."""
        client, body = self.client, self.body_id
        for name, index in self._links.items():
            link = self._bodies.links[name]
            settings = {
                "linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0,
                "maxJointVelocity": _UNBOUNDED_VELOCITY,
                "lateralFriction": DEFAULT_FRICTION if link.mu is None else link.mu,
                "restitution": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0,
            }
            if link.inertial is not None and not (index == -1 and self.fixed_base):
                # Bullet zeroes tensors that break the triangle inequality: say it again.
                settings["localInertiaDiagonal"] = bullet_file.principal_inertial(link.inertial)[1]
            pybullet.changeDynamics(body, index, physicsClientId=client, **settings)
        for index in self._bullet_joint:
            pybullet.changeDynamics(body, index, jointLimitForce=NO_LIMIT_FORCE,
                                    physicsClientId=client)
        self.active_friction = list(self.friction)
        for i in range(len(self.joint_names)):
            self.restore_friction(i)

    def _make_gears(self) -> list[int]:
        gears = []
        for i, name in enumerate(self.joint_names):
            mimic = self.description.joints[name].mimic
            if mimic is None:
                continue
            leader = self._bullet_joint[self._slot[mimic.joint]]
            gear = pybullet.createConstraint(
                self.body_id, self._bullet_joint[i], self.body_id, leader, pybullet.JOINT_GEAR,
                (0, 0, 1), (0, 0, 0), (0, 0, 0), physicsClientId=self.client)
            pybullet.changeConstraint(gear, gearRatio=-mimic.multiplier, maxForce=1e12, erp=0.2,
                                      relativePositionTarget=mimic.offset,
                                      physicsClientId=self.client)
            gears.append(gear)
        return gears

    def restore_friction(self, slot: int) -> None:
        """Coulomb friction of a joint: a motor towards standstill of at most that effort."""
        self._motor(slot, 0.0, self.friction[slot])
        self.active_friction[slot] = self.friction[slot]

    def _motor(self, slot: int, velocity: float, force: float, gain: float = 1.0) -> None:
        pybullet.setJointMotorControl2(
            self.body_id, self._bullet_joint[slot], pybullet.VELOCITY_CONTROL,
            targetVelocity=velocity, force=force, velocityGain=gain, physicsClientId=self.client)
