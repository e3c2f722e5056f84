"""The link frames of a model: poses, twists, moving it as a whole, forces on its links."""

from types import MappingProxyType

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.poses import (
    Pose,
    Quaternion,
    Twist,
    Vector3,
    add,
    cross,
    rotate,
    subtract,
)
from aras_sim_bridge.world.bullet import pybullet
from aras_sim_bridge.world.model_joints import ModelJoints


class ModelFrames(ModelJoints):
    """The part of `Model` that knows where its links are and how they move."""

    def pose(self) -> Pose:
        """world_T_root: the frame of the root link."""
        return self.link_pose(self.description.root)

    def twist(self) -> Twist:
        """Twist of the root link's frame, in world axes."""
        return self.link_twist(self.description.root)

    def link_pose(self, name: str) -> Pose:
        """world_T_link of the link's own (URDF) frame, unpacks as (xyz, quat xyzw).

        Raises:
            WorldError: unknown link.
        """
        return self._com_pose(self._link_index(name)) @ self._inertial_poses[name].inverse()

    def link_twist(self, name: str) -> Twist:
        """Twist of the link's frame: velocity of its origin, in world axes (m/s, rad/s)."""
        return self.link_state(name)[1]

    def link_state(self, name: str) -> tuple[Pose, Twist]:
        """(world_T_link, twist of the link's origin in world axes)."""
        index = self._link_index(name)
        inertial = self._inertial_poses[name]
        if index == -1:
            com = self._com_pose(index)
            linear, angular = pybullet.getBaseVelocity(self.body_id, self.client)
        else:
            state = pybullet.getLinkState(self.body_id, index, 1, 1, self.client)
            com, linear, angular = Pose(state[0], state[1]), state[6], state[7]
        return _frame_state(com, linear, angular, inertial)

    def link_states(self) -> dict[str, tuple[Pose, Twist]]:
        """`link_state` of every link in file order, in one call to Bullet."""
        names = [n for n in self.link_names if self._links[n] >= 0]
        indices = [self._links[n] for n in names]
        states = pybullet.getLinkStates(self.body_id, indices, 1, 1, self.client) if names else ()
        found = {
            n: _frame_state(Pose(s[0], s[1]), s[6], s[7], self._inertial_poses[n])
            for n, s in zip(names, states, strict=True)
        }
        found[self.description.root] = self.link_state(self.description.root)
        return {n: found[n] for n in self.link_names}

    def frames(self, indices: list[int]) -> tuple[list[Vector3], list[Quaternion]]:
        """Positions and orientations of the frames of links by Bullet's numbers from 0 on, in one
        call to Bullet; `pose` is that of the root."""
        states = pybullet.getLinkStates(self.body_id, indices, 0, 1, self.client)
        return [state[4] for state in states], [state[5] for state in states]

    @property
    def link_indices(self) -> MappingProxyType:
        """Bullet's index of each link by name; -1 is the root."""
        return MappingProxyType(self._links)

    def link_index(self, name: str) -> int:
        """Bullet's index of a link, -1 for the root."""
        return self._link_index(name)

    def _link_index(self, name: str) -> int:
        index = self._links.get(name)
        if index is None:
            raise WorldError(f"model '{self.name}' has no link '{name}'; "
                             f"it has: {', '.join(self.link_names)}")
        return index

    def _com_pose(self, index: int) -> Pose:
        if index == -1:
            return Pose(*pybullet.getBasePositionAndOrientation(self.body_id, self.client))
        state = pybullet.getLinkState(self.body_id, index, 0, 1, self.client)
        return Pose(state[0], state[1])

    def set_pose(self, pose: Pose) -> None:
        """Move the whole model rigidly so that its root frame is at `pose`; joints keep angles."""
        com = pose @ self._inertial_poses[self.description.root]
        pybullet.resetBasePositionAndOrientation(self.body_id, com.xyz, com.quat,
                                                 physicsClientId=self.client)
        if self.fixed_base:
            self.on_moved()

    def set_twist(self, twist: Twist) -> None:
        """Give the model `twist` (of its root frame, world axes) as one rigid body.

        Joint velocities become zero. A model with a fixed base keeps still.
        """
        self.stop_joints()
        if self.fixed_base:
            return
        root = self.description.root
        arm = rotate(self.pose().quat, self._inertial_poses[root].xyz)
        linear = add(twist.linear, cross(twist.angular, arm))
        pybullet.resetBaseVelocity(self.body_id, linear, twist.angular,
                                   physicsClientId=self.client)

    def apply_force(self, link: str, force: tuple, position: tuple,
                    torque: tuple = (0.0, 0.0, 0.0)) -> None:
        """Force (N) at a world position and torque (N m), world axes, for the next step only."""
        index = self._link_index(link)
        if any(force):
            pybullet.applyExternalForce(self.body_id, index, force, position,
                                        pybullet.WORLD_FRAME, physicsClientId=self.client)
        if any(torque):
            pybullet.applyExternalTorque(self.body_id, index, torque, pybullet.WORLD_FRAME,
                                         physicsClientId=self.client)


def _frame_state(com: Pose, linear: tuple, angular: tuple, inertial: Pose) -> tuple[Pose, Twist]:
    """Pose and twist of a link frame from those of its centre of mass."""
    pose = com @ inertial.inverse()
    lever = subtract(pose.xyz, com.xyz)
    return pose, Twist(add(linear, cross(angular, lever)), angular)
