"""World: models in Bullet, stepped together."""

import logging
import math
import weakref
from collections.abc import Mapping, Sequence

import numpy as np

from aras_sim_bridge.description import shapes
from aras_sim_bridge.description.gazebo_materials import COLOURS
from aras_sim_bridge.description.types import (
    Collision,
    Geometry,
    Link,
    RobotDescription,
    Visual,
)
from aras_sim_bridge.errors import (
    UnknownJointError,
    UnknownModelError,
    WindowError,
    WorldError,
)
from aras_sim_bridge.world import bullet_files
from aras_sim_bridge.world.attachments import Attachments
from aras_sim_bridge.world.bullet import connect, pybullet, release_client, silence_output
from aras_sim_bridge.world.checks import LARGEST, check_simulable
from aras_sim_bridge.world.deep_contacts import DeepContacts
from aras_sim_bridge.world.friction import ContactFriction
from aras_sim_bridge.world.isolation import IsolationMonitor
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.reach import disable_distant_pairs
from aras_sim_bridge.world.resting_base import FIXED_BASE_ARRAYS, RestingBases
from aras_sim_bridge.world.sliding import SlidingFriction
from aras_visual_servo_base.poses import IDENTITY, Pose, Twist, check_pose, check_vector

logger = logging.getLogger(__name__)

SMALLEST_STEP = 1e-6  # s; simulated time is counted in nanoseconds
LARGEST_STEP = 0.1  # s; beyond it no PID of ours and no contact is stable
GRAVITY_BOUND = 100.0  # m/s², dynamic_reconfigure's range
# Bullet stops iterating when the squared impulse change of a sweep falls below this; its default
# of 1e-7 leaves joints 2e-4 rad off, 1e-12 leaves 6e-7 rad and costs 3 us a step more.
SOLVER_RESIDUAL = 1e-12


class World:
    """The physics world: Bullet without its hidden damping, motors and velocity bounds.

    It has models with links and joints, gravity, contacts and joint friction; `Simulation.world` is
    one. `spawn` and `delete` change its models, `step` moves them by one time step. Poses are in
    the world's frame, z up; lengths in m, angles in rad, forces in N and N m.

    Args:
        time_step: s.
        gravity: m/s².
        gui: open PyBullet's window.
        solver_iterations: bound on the sweeps of the constraint solver.

    Attributes:
        client: Bullet client id, for renderers.
        models: by name, in spawn order; a part that no joint holds to its model comes after it as
            <model>::<its root link>.
        revision: counts spawns, deletions and resets; a copy of the scene is out of date when it
            has changed.
        islands: decides which bolted models make steps of their own.
        bases: holds the bases of free models that are at rest.
        attachments: fixed joints between models.
        friction: gives each contact the smaller of its two coefficients.

    Raises:
        WorldError: impossible step or gravity, or Bullet does not start.
    """

    def __init__(self, time_step: float = 0.001,
                 gravity: tuple[float, float, float] = (0.0, 0.0, -9.8), gui: bool = False,
                 solver_iterations: int = 50) -> None:
        self._time_step = _check_step(time_step)
        self._gravity = _check_gravity(gravity)
        self._iterations = _check_iterations(solver_iterations)
        self.models: dict[str, Model] = {}
        self._own_dynamics_models: list[Model] = []
        self._bullet_models: list[Model] = []
        self._bullet_steps = self._has_disabled_pairs = False
        self.isolation = IsolationMonitor(self.models, gui)
        self.revision = 0
        try:
            self.client = connect(gui)
        except pybullet.error as error:
            raise WindowError(
                f"Bullet cannot open its window ({error}); start with gui:=false") from None
        if self.client < 0:
            raise WorldError("Bullet does not start: no free client, or no display for gui:=true")
        self._gui = self._has_stepped = gui
        # Bullet keeps 30 MB for a robot: also of a world that is dropped without `close`.
        self._finalizer = weakref.finalize(self, pybullet.disconnect, self.client)
        self._finalizer.atexit = False
        if gui:  # without panels of sliders and empty previews, and shadows: half a picture's cost
            for part in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS):
                pybullet.configureDebugVisualizer(part, False, physicsClientId=self.client)
        self._has_direct_solver = False
        self.friction = ContactFriction(self.client)
        self._sliding = SlidingFriction(self.client)
        self._deep = DeepContacts(self.client, self.models)
        self.resting_bases = RestingBases(self.models, self._update_models)
        self.attachments = Attachments(self.client, self.models, self._update_attachments)
        self._configure()

    def _configure(self) -> None:
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self._time_step, numSolverIterations=self._iterations,
            solverResidualThreshold=SOLVER_RESIDUAL, deterministicOverlappingPairs=True,
            # Meshes and files are read anew for each model: they may have changed.
            enableFileCaching=False,
            # Split impulses leave a joint beyond its limit by more than 4 cm (bullet3#2944).
            useSplitImpulse=False,
            restitutionVelocityThreshold=0.0,  # impacts.py decides
            # Both sides of a pair have to want it; Bullet is content with one.
            collisionFilterMode=0,
            physicsClientId=self.client)
        pybullet.setGravity(*self._gravity, physicsClientId=self.client)

    def _choose_solver(self) -> None:
        """Solve friction, stops and motors of joints directly where every model is bolted down.

        Sweeps need hundreds of iterations where joints are coupled as tightly as the ARAS arm's: 50
        of them leave J5 creeping at 2e-5 rad/s when it rests and take twice as long as a direct
        solution (Dantzig's). With contacts Bullet goes back to sweeps by itself, step by step; a
        body that stands on the ground would be shaken by the changes, so then it is sweeps always.
        """
        direct = not self.attachments and all(model.fixed_base and not model.description.loops
                                              for model in self.models.values())
        if direct != self._has_direct_solver:
            self._has_direct_solver = direct
            solver = (pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG if direct
                      else pybullet.CONSTRAINT_SOLVER_LCP_SI)
            with silence_output():  # "switched solver"
                pybullet.setPhysicsEngineParameter(constraintSolverType=solver,
                                                   physicsClientId=self.client)

    @property
    def time_step(self) -> float:
        """Physics step, s."""
        return self._time_step

    @property
    def gravity(self) -> tuple[float, float, float]:
        """m/s²."""
        return self._gravity

    @property
    def solver_iterations(self) -> int:
        """Bound on the sweeps of the constraint solver."""
        return self._iterations

    def set_physics(self, time_step: float | None = None,
                    gravity: tuple[float, float, float] | None = None,
                    solver_iterations: int | None = None) -> None:
        """Change what is given; WorldError, and nothing changed, when one of them is impossible."""
        step = self._time_step if time_step is None else _check_step(time_step)
        down = self._gravity if gravity is None else _check_gravity(gravity)
        sweeps = (self._iterations if solver_iterations is None
                  else _check_iterations(solver_iterations))
        self.resting_bases.release()
        self._time_step, self._gravity, self._iterations = step, down, sweeps
        self._configure()
        for model in self.models.values():
            model.update_physics(down)

    # ------------------------------------------------------------------ models

    def spawn(self, description: RobotDescription, name: str, pose: Pose = IDENTITY,
              joint_positions: Mapping[str, float] | None = None,
              fixed_base: bool | None = None) -> Model:
        """Put a model into the world, at rest.

        Args:
            description: what it is.
            name: its name here.
            pose: world_T_root.
            joint_positions: rad or m; absent joints start at 0 (mimicking ones follow).
            fixed_base: bolt the root link where it is put; None follows the description: a root
                named 'world' or without mass, `<kinematic>` on it, or `<static>` fix it. One
                without mass is bolted in any case.

        Raises:
            WorldError: name taken or empty, pose or position impossible, joint kinds or masses
                that cannot be simulated; the world is unchanged then.
            DescriptionError: a mesh file that is damaged; the same.
        """
        if not isinstance(name, str) or not name:
            raise WorldError("a model needs a name that is not empty")
        if name in self.models:
            raise WorldError(f"a model named '{name}' exists already; delete it or take another")
        whole = (description, *description.parts)
        for one in whole:
            check_simulable(one, name)
            for text in shapes.read_mesh_files(one, name):
                logger.warning("%s", text)
        pose = check_pose(pose, f"model '{name}'", WorldError, zero_is_identity=True)
        if math.hypot(*pose.xyz) > LARGEST:
            raise WorldError(f"model '{name}': position {pose.xyz} is beyond {LARGEST:.0e} m")
        starts = _compute_start_positions(whole, name, joint_positions or {})
        bodies = pybullet.getNumBodies(physicsClientId=self.client)
        made: list[Model] = []
        try:
            for one, start in zip(whole, starts, strict=True):
                own, at = name, pose
                if made:
                    own, at = f"{name}::{one.root}", pose @ Pose.from_rpy(*one.initial_pose)
                fixed = bullet_files.is_root_fixed(one, None if made else fixed_base)
                made.append(Model(self.client, one, own, at, start, fixed, self._gravity,
                                  self._on_model_move, made[0] if made else None))
        except WorldError:
            for i in range(pybullet.getNumBodies(physicsClientId=self.client) - 1, bodies - 1, -1):
                pybullet.removeBody(pybullet.getBodyUniqueId(i, physicsClientId=self.client),
                                    physicsClientId=self.client)
            raise
        for model in made:
            self.models[model.name] = model
            self.resting_bases.release_for(model)
        self._update_models()
        logger.debug("spawned '%s': %d links, %d joints, %s base", name,
                     sum(len(model.link_names) for model in made),
                     sum(len(model.joint_names) for model in made),
                     "fixed" if made[0].fixed_base else "free")
        return made[0]

    def spawn_ground_plane(self, name: str = "ground_plane") -> Model:
        """Gazebo's ground plane: z = 0, grey, 100 m wide to the eye, endless to the touch."""
        plane = Geometry("plane", size=(100.0, 100.0, 0.0))
        link = Link("link", None, (Visual("visual", (0, 0, 0), (0, 0, 0), plane),),
                    (Collision("collision", (0, 0, 0), (0, 0, 0), plane),), mu=100.0)
        return self.spawn(RobotDescription(name, "link", {"link": link}, {}, static=True,
                                           colours={"link": COLOURS["Gazebo/Grey"]}), name)

    @property
    def main_models(self) -> dict[str, Model]:
        """The models by name, without the parts of others."""
        return {name: model for name, model in self.models.items() if model.main_model is model}

    def model(self, name: str) -> Model:
        """The model called `name`; WorldError naming those that exist."""
        model = self.models.get(name)
        if model is None or model.main_model is not model:
            raise UnknownModelError(name, self.main_models)
        return model

    def delete(self, name: str) -> None:
        """Take a model out; WorldError when there is none of that name."""
        for model in self.model(name).bodies:
            self.resting_bases.release_from(model)
            self.attachments.detach_model(model)
            model.remove()
            del self.models[model.name]
        self._update_models()

    def change_model(self, name: str, description: RobotDescription) -> None:
        """Give a model other masses, damping or limits (see changes.py); its state goes on.

        Raises:
            WorldError, DescriptionError: no such model, a joint that moves no mass, or a mesh file
                that was damaged since; nothing is changed then.
        """
        model = self.models.get(name) or self.model(name)
        check_simulable(description, name)
        shapes.read_mesh_files(description, name)
        self.resting_bases.release()
        self.attachments.suspend(model)
        model.rebuild(description)
        self._update_models()

    def _update_attachments(self) -> None:
        """Models were attached or let go: a base that holds something does not stand still."""
        self.resting_bases.release()
        self._update_models()

    def _update_models(self) -> None:
        """Models came, went or were loaded anew: note what a step has to do for them."""
        self.revision += 1
        self.attachments.renew()
        self.friction.set_models(self.models.values())
        self._sliding.set_models(self.models.values())
        self._deep.start_watching()
        self._choose_solver()
        self.isolation.refresh()
        self._has_disabled_pairs = False
        self._update_isolation()
        self.resting_bases.refresh()

    def _on_model_move(self, model: Model, is_moved: bool, has_new_positions: bool = False) -> None:
        """A model was `is_moved` elsewhere as a whole; or `has_new_positions`: its joints were put
        elsewhere; or pushed."""
        if is_moved or has_new_positions:
            self._deep.continue_watching()
        if is_moved and model.fixed_base:
            self.resting_bases.release_from(model)
            self.isolation.replace_model(model)
            self._has_disabled_pairs = False
        else:
            self.isolation.steps_until_update = 0
            self._sliding.check_all()

    def _update_isolation(self) -> None:
        """Choose who makes the steps of which model (see islands.py)."""
        self.isolation.update(self._time_step)
        models = self.models.values()
        self._own_dynamics_models = [model for model in models if model.joints.has_own_dynamics]
        self._bullet_steps = self._gui or any(
            not (model.fixed_base and (model.body.is_asleep or not model.joint_names))
            for model in models)
        self._bullet_models = [
            model
            for model in models
            if self._bullet_steps and model.needs_steps and not model.joints.has_own_dynamics
        ]
        if self._bullet_steps and not self._has_disabled_pairs:
            self._has_disabled_pairs = True
            disable_distant_pairs(list(models))
            self.attachments.disable_contacts()

    # ------------------------------------------------------------------ time

    def step(self) -> None:
        """Advance physics by one time step, with the efforts and forces given since the last.

        Raises:
            WorldError: an effort is not finite; no model has moved then.
        """
        if self.resting_bases.is_new:
            self.resting_bases.fix_at_start()
        if self.isolation.steps_until_update <= 0:
            self._update_isolation()
        self.isolation.steps_until_update -= 1
        dt = self._time_step
        for model in (*self._own_dynamics_models, *self._bullet_models):
            model.check_efforts()
        for model in self._own_dynamics_models:
            model.advance(dt)
        bullet_steps = self._bullet_steps
        if bullet_steps:
            self._step_bullet(dt)
        if self.resting_bases.fixed_bases:
            self.resting_bases.check_support(dt, self.isolation.is_base_touchable)
        if bullet_steps and self.resting_bases.is_active:
            self.resting_bases.detect_rest()

    def _step_bullet(self, dt: float) -> None:
        """One step of all that does not make its own."""
        for model in self._bullet_models:
            model.before_step(dt)
        if self.friction.is_active:
            self.friction.before_step()
        if self._sliding.loose:
            self._sliding.before_step(dt)
        if self._deep.is_active:
            self._deep.before_step(dt)
        pybullet.stepSimulation(self.client)
        self._has_stepped = True
        if self._deep.is_active:
            self._deep.after_step(dt)
        for model in self._bullet_models:
            model.after_step()

    @property
    def steps_until_contact(self) -> int:
        """Steps that `get_compiled_step`'s model may make before something else may touch it."""
        return self.isolation.steps_until_update

    def get_compiled_step(self, model: Model) -> tuple[np.ndarray | float, ...] | None:
        """What compiled steps of a model take (see cycle.py): JointSpace.arrays, the time step, and
        how it stands; None where they may not be made without the world: something else has joints
        or can touch it, or an effort waits. What is loose catches up in `finish_compiled_steps`."""
        if self.isolation.steps_until_update <= 0:
            self._update_isolation()
        if (
            self._own_dynamics_models != [model]
            or self._bullet_models
            or self.resting_bases.is_new
            or self.resting_bases.is_active
            or self.isolation.is_base_touchable
        ):
            return None
        joints, held = model.joints, self.resting_bases.fixed_bases
        if not joints.is_calm:
            return None
        stands = held[0].arrays[5:] if held else FIXED_BASE_ARRAYS
        space = joints.space
        return *space.arrays, self._time_step, bool(held), space.previous_speeds, *stands

    def finish_compiled_steps(
        self, model: Model, count: int, diverged_joint: int = -1, is_base_supported: bool = True
    ) -> None:
        """`count` such steps were made.

        Args:
            bad: joint that diverged, or -1. borne: whether the ground bore the last one.

        Raises:
            WorldError: the simulation diverged.
        """
        model.joints.finish_steps(diverged_joint)
        self.isolation.steps_until_update -= count
        for _ in range(count if self._bullet_steps else 0):
            self._step_bullet(self._time_step)
        if not is_base_supported:
            self.resting_bases.release_overload()

    def reset_world(self) -> None:
        """Models back to their spawn poses, all velocities zero; joint angles stay (Gazebo)."""
        for model in self.models.values():
            model.set_pose(model.spawn_pose)
            model.set_twist(Twist())
        self.resting_bases.refresh()

    def reset_simulation(self) -> None:
        """A fresh Bullet with the same models at their spawn poses and configurations, unattached.

        From here on every run with the same inputs is bit-identical. Model objects stay valid;
        their body ids may change.

        Raises:
            DescriptionError: a mesh file was damaged since; nothing is changed then.
        """
        for model in self.models.values():
            shapes.read_mesh_files(model.description, model.name)
        self.resting_bases.release()
        pybullet.resetSimulation(physicsClientId=self.client)
        self.attachments.clear()
        self._deep.clear()
        self._has_direct_solver = False
        self._configure()
        for model in self.models.values():
            model.reload()
        self._update_models()

    def close(self) -> None:
        """Leave Bullet. Safe to call twice."""
        self._finalizer.detach()
        if self.client >= 0 and pybullet.isConnected(self.client):
            release_client(self.client, not self._has_stepped)
        self.client = -1

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _check_step(value: float) -> float:
    if not (isinstance(value, (int, float)) and SMALLEST_STEP <= value <= LARGEST_STEP):
        raise WorldError(
            f"time step {value} s is not in [{SMALLEST_STEP}, {LARGEST_STEP}]; 0.001 is usual"
        )
    return float(value)


def _check_gravity(value: tuple) -> tuple[float, float, float]:
    gravity = check_vector(value, "gravity", WorldError)
    if max(abs(g) for g in gravity) > GRAVITY_BOUND:
        raise WorldError(f"gravity {gravity} is beyond ±{GRAVITY_BOUND} m/s²")
    return gravity


def _check_iterations(value: int) -> int:
    if not 1 <= value <= 10000 or value != int(value):
        raise WorldError(f"{value} solver iterations: needs a whole number from 1 to 10000")
    return int(value)


def _compute_start_positions(
    descriptions: Sequence[RobotDescription], name: str, positions: Mapping[str, float]
) -> list[dict[str, float]]:
    """Positions of the joints that are not at 0, of each body of a model."""
    every = tuple(joint for one in descriptions for joint in one.list_moving_joints())
    for joint, value in positions.items():
        if joint not in every:
            raise UnknownJointError(name, joint, every)
        if not math.isfinite(value):
            raise WorldError(f"model '{name}', joint '{joint}': position {value} is not finite")
    return [_compute_start(one, positions) for one in descriptions]


def _compute_start(
    description: RobotDescription, positions: Mapping[str, float]
) -> dict[str, float]:
    moving = description.list_moving_joints()
    start = {joint: float(value) for joint, value in positions.items() if joint in moving}
    for _ in moving:
        for joint in moving:
            mimic = description.joints[joint].mimic
            if mimic is not None and joint not in positions:
                start[joint] = mimic.multiplier * start.get(mimic.joint, 0.0) + mimic.offset
    return start
