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
from aras_sim_bridge.world import bullet_file
from aras_sim_bridge.world.attachments import Attachments
from aras_sim_bridge.world.bullet import connected, give_back, pybullet, quiet
from aras_sim_bridge.world.checks import LARGEST, check_simulable
from aras_sim_bridge.world.deep_contacts import DeepContacts
from aras_sim_bridge.world.friction import ContactFriction
from aras_sim_bridge.world.islands import Islands
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.reach import leave_out_pairs
from aras_sim_bridge.world.sliding import SlidingFriction
from aras_sim_bridge.world.standing import BOLTED, FreeBases
from aras_visual_servo_base.poses import IDENTITY, Pose, Twist, checked_pose, checked_vector

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
        self._time_step = _checked_step(time_step)
        self._gravity = _checked_gravity(gravity)
        self._iterations = _checked_iterations(solver_iterations)
        self.models: dict[str, Model] = {}
        self._own: list[Model] = []
        self._bullets: list[Model] = []
        self._bullet_steps = self._pairs_left_out = False
        self.islands = Islands(self.models, gui)
        self.revision = 0
        try:
            self.client = connected(gui)
        except pybullet.error as error:
            raise WindowError(
                f"Bullet cannot open its window ({error}); start with gui:=false") from None
        if self.client < 0:
            raise WorldError("Bullet does not start: no free client, or no display for gui:=true")
        self._gui = self._stepped = gui
        # Bullet keeps 30 MB for a robot: also of a world that is dropped without `close`.
        self._leave = weakref.finalize(self, pybullet.disconnect, self.client)
        self._leave.atexit = False
        if gui:  # without panels of sliders and empty previews, and shadows: half a picture's cost
            for part in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS):
                pybullet.configureDebugVisualizer(part, False, physicsClientId=self.client)
        self._direct = False
        self.friction = ContactFriction(self.client)
        self._sliding = SlidingFriction(self.client)
        self._deep = DeepContacts(self.client, self.models)
        self.bases = FreeBases(self.models, self._models_changed)
        self.attachments = Attachments(self.client, self.models, self._attachments_changed)
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
        if direct != self._direct:
            self._direct = direct
            solver = (pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG if direct
                      else pybullet.CONSTRAINT_SOLVER_LCP_SI)
            with quiet():  # "switched solver"
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
        step = self._time_step if time_step is None else _checked_step(time_step)
        down = self._gravity if gravity is None else _checked_gravity(gravity)
        sweeps = (self._iterations if solver_iterations is None
                  else _checked_iterations(solver_iterations))
        self.bases.release()
        self._time_step, self._gravity, self._iterations = step, down, sweeps
        self._configure()
        for model in self.models.values():
            model.physics_changed(down)

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
            for text in shapes.read_all(one, name):
                logger.warning("%s", text)
        pose = checked_pose(pose, f"model '{name}'", WorldError, zero_is_identity=True)
        if math.hypot(*pose.xyz) > LARGEST:
            raise WorldError(f"model '{name}': position {pose.xyz} is beyond {LARGEST:.0e} m")
        starts = _start_positions(whole, name, joint_positions or {})
        bodies = pybullet.getNumBodies(physicsClientId=self.client)
        made: list[Model] = []
        try:
            for one, start in zip(whole, starts, strict=True):
                own, at = name, pose
                if made:
                    own, at = f"{name}::{one.root}", pose @ Pose.from_rpy(*one.initial_pose)
                fixed = bullet_file.root_is_fixed(one, None if made else fixed_base)
                made.append(Model(self.client, one, own, at, start, fixed, self._gravity,
                                  self._model_moved, made[0] if made else None))
        except WorldError:
            for i in range(pybullet.getNumBodies(physicsClientId=self.client) - 1, bodies - 1, -1):
                pybullet.removeBody(pybullet.getBodyUniqueId(i, physicsClientId=self.client),
                                    physicsClientId=self.client)
            raise
        for model in made:
            self.models[model.name] = model
            self.bases.came(model)
        self._models_changed()
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
    def whole_models(self) -> dict[str, Model]:
        """The models by name, without the parts of others."""
        return {name: model for name, model in self.models.items() if model.whole is model}

    def model(self, name: str) -> Model:
        """The model called `name`; WorldError naming those that exist."""
        model = self.models.get(name)
        if model is None or model.whole is not model:
            raise UnknownModelError(name, self.whole_models)
        return model

    def delete(self, name: str) -> None:
        """Take a model out; WorldError when there is none of that name."""
        for model in self.model(name).bodies:
            self.bases.leaves(model)
            self.attachments.leaves(model)
            model.remove()
            del self.models[model.name]
        self._models_changed()

    def change(self, name: str, description: RobotDescription) -> None:
        """Give a model other masses, damping or limits (see changes.py); its state goes on.

        Raises:
            WorldError, DescriptionError: no such model, a joint that moves no mass, or a mesh file
                that was damaged since; nothing is changed then.
        """
        model = self.models.get(name) or self.model(name)
        check_simulable(description, name)
        shapes.read_all(description, name)
        self.bases.release()
        self.attachments.suspend(model)
        model.rebuild(description)
        self._models_changed()

    def _attachments_changed(self) -> None:
        """Models were attached or let go: a base that holds something does not stand still."""
        self.bases.release()
        self._models_changed()

    def _models_changed(self) -> None:
        """Models came, went or were loaded anew: note what a step has to do for them."""
        self.revision += 1
        self.attachments.renew()
        self.friction.models_changed(self.models.values())
        self._sliding.models_changed(self.models.values())
        self._deep.came()
        self._choose_solver()
        self.islands.models_moved()
        self._pairs_left_out = False
        self._look()
        self.bases.models_changed()

    def _model_moved(self, model: Model, put: bool, posed: bool = False) -> None:
        """A model was `put` elsewhere as a whole; or `posed`: its joints were put elsewhere; or
        pushed."""
        if put or posed:
            self._deep.put()
        if put and model.fixed_base:
            self.bases.leaves(model)
            self.islands.put(model)
            self._pairs_left_out = False
        else:
            self.islands.wait = 0
            self._sliding.pushed()

    def _look(self) -> None:
        """Choose who makes the steps of which model (see islands.py)."""
        self.islands.look(self._time_step)
        models = self.models.values()
        self._own = [model for model in models if model.joints.own]
        self._bullet_steps = self._gui or any(
            not (model.fixed_base and (model.body.asleep or not model.joint_names))
            for model in models)
        self._bullets = [model for model in models
                         if self._bullet_steps and model.needs_steps and not model.joints.own]
        if self._bullet_steps and not self._pairs_left_out:
            self._pairs_left_out = True
            leave_out_pairs(list(models))
            self.attachments.hide()

    # ------------------------------------------------------------------ time

    def step(self) -> None:
        """Advance physics by one time step, with the efforts and forces given since the last.

        Raises:
            WorldError: an effort is not finite; no model has moved then.
        """
        if self.bases.fresh:
            self.bases.begin()
        if self.islands.wait <= 0:
            self._look()
        self.islands.wait -= 1
        dt = self._time_step
        for model in (*self._own, *self._bullets):
            model.check_efforts()
        for model in self._own:
            model.advance(dt)
        bullet_steps = self._bullet_steps
        if bullet_steps:
            self._step_bullet(dt)
        if self.bases.held:
            self.bases.check(dt, self.islands.touchable)
        if bullet_steps and self.bases.watched:
            self.bases.look()

    def _step_bullet(self, dt: float) -> None:
        """One step of all that does not make its own."""
        for model in self._bullets:
            model.before_step(dt)
        if self.friction.watched:
            self.friction.before_step()
        if self._sliding.loose:
            self._sliding.before_step(dt)
        if self._deep.watched:
            self._deep.before_step(dt)
        pybullet.stepSimulation(self.client)
        self._stepped = True
        if self._deep.watched:
            self._deep.after_step(dt)
        for model in self._bullets:
            model.after_step()

    @property
    def outlook(self) -> int:
        """Steps that `alone`'s model may make before something else may touch it."""
        return self.islands.wait

    def alone(self, model: Model) -> tuple[np.ndarray | float, ...] | None:
        """What compiled steps of a model take (see cycle.py): JointSpace.arrays, the time step, and
        how it stands; None where they may not be made without the world: something else has joints
        or can touch it, or an effort waits. What is loose catches up in `advanced`."""
        if self.islands.wait <= 0:
            self._look()
        if (self._own != [model] or self._bullets or self.bases.fresh or self.bases.watched
                or self.islands.touchable):
            return None
        joints, held = model.joints, self.bases.held
        if not joints.calm:
            return None
        stands = held[0].arrays[5:] if held else BOLTED
        space = joints.space
        return *space.arrays, self._time_step, bool(held), space.before, *stands

    def advanced(self, model: Model, made: int, bad: int = -1, borne: bool = True) -> None:
        """`made` such steps were made.

        Args:
            bad: joint that diverged, or -1. borne: whether the ground bore the last one.

        Raises:
            WorldError: the simulation diverged.
        """
        model.joints.advanced(bad)
        self.islands.wait -= made
        for _ in range(made if self._bullet_steps else 0):
            self._step_bullet(self._time_step)
        if not borne:
            self.bases.let_go()

    def reset_world(self) -> None:
        """Models back to their spawn poses, all velocities zero; joint angles stay (Gazebo)."""
        for model in self.models.values():
            model.set_pose(model.spawn_pose)
            model.set_twist(Twist())
        self.bases.models_changed()

    def reset_simulation(self) -> None:
        """A fresh Bullet with the same models at their spawn poses and configurations, unattached.

        From here on every run with the same inputs is bit-identical. Model objects stay valid;
        their body ids may change.

        Raises:
            DescriptionError: a mesh file was damaged since; nothing is changed then.
        """
        for model in self.models.values():
            shapes.read_all(model.description, model.name)
        self.bases.release()
        pybullet.resetSimulation(physicsClientId=self.client)
        self.attachments.clear()
        self._deep.clear()
        self._direct = False
        self._configure()
        for model in self.models.values():
            model.reload()
        self._models_changed()

    def close(self) -> None:
        """Leave Bullet. Safe to call twice."""
        self._leave.detach()
        if self.client >= 0 and pybullet.isConnected(self.client):
            give_back(self.client, not self._stepped)
        self.client = -1

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _checked_step(value: float) -> float:
    if not (isinstance(value, (int, float)) and SMALLEST_STEP <= value <= LARGEST_STEP):
        raise WorldError(
            f"time step {value} s is not in [{SMALLEST_STEP}, {LARGEST_STEP}]; 0.001 is usual"
        )
    return float(value)


def _checked_gravity(value: tuple) -> tuple[float, float, float]:
    gravity = checked_vector(value, "gravity", WorldError)
    if max(abs(g) for g in gravity) > GRAVITY_BOUND:
        raise WorldError(f"gravity {gravity} is beyond ±{GRAVITY_BOUND} m/s²")
    return gravity


def _checked_iterations(value: int) -> int:
    if not 1 <= value <= 10000 or value != int(value):
        raise WorldError(f"{value} solver iterations: needs a whole number from 1 to 10000")
    return int(value)


def _start_positions(whole: Sequence[RobotDescription], name: str, given: Mapping[str, float]
                     ) -> list[dict[str, float]]:
    """Positions of the joints that are not at 0, of each body of a model."""
    every = tuple(joint for one in whole for joint in one.moving_joints())
    for joint, value in given.items():
        if joint not in every:
            raise UnknownJointError(name, joint, every)
        if not math.isfinite(value):
            raise WorldError(f"model '{name}', joint '{joint}': position {value} is not finite")
    return [_start_of(one, given) for one in whole]


def _start_of(description: RobotDescription, given: Mapping[str, float]) -> dict[str, float]:
    moving = description.moving_joints()
    start = {joint: float(value) for joint, value in given.items() if joint in moving}
    for _ in moving:
        for joint in moving:
            mimic = description.joints[joint].mimic
            if mimic is not None and joint not in given:
                start[joint] = mimic.multiplier * start.get(mimic.joint, 0.0) + mimic.offset
    return start
