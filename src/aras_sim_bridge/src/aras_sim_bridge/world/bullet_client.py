"""Connection of a World to Bullet: its client, window and constraint solver."""

from __future__ import annotations

import weakref

from aras_sim_bridge.errors import WindowError, WorldError
from aras_sim_bridge.world.bullet import connect, pybullet, release_client, silence_output


class BulletClient:
    """Client of Bullet, which is released when this object is deleted or closed.

    Attributes:
        id: Bullet's client id; -1 after `close`.
        is_unused: whether the client has no window and has made no step. The owner sets it.
    """

    def __init__(self, gui: bool) -> None:
        """Connect a client, with PyBullet's window if `gui` is True.

        Raises:
            WorldError: Bullet does not start, or cannot open its window.
        """
        try:
            self.id = connect(gui)
        except pybullet.error as error:
            raise WindowError(
                f"Bullet cannot open its window ({error}); start with gui:=false") from None
        if self.id < 0:
            raise WorldError("Bullet does not start: it has no free client, or gui:=true has no "
                             "display; close other worlds, or start with gui:=false")
        self.is_unused = not gui
        self._has_direct_solver = False
        # Bullet needs 30 MB for a robot. The finalizer releases this memory even if `close` is not
        # called.
        self._finalizer = weakref.finalize(self, pybullet.disconnect, self.id)
        self._finalizer.atexit = False
        # Hide the side panels and the shadows of the window, because they take half of the drawing
        # time.
        if gui:
            for part in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_SHADOWS):
                pybullet.configureDebugVisualizer(part, False, physicsClientId=self.id)

    def choose_solver(self, direct: bool) -> None:
        """Use Dantzig's direct solver for friction, stops and motors, or the iterative solver.

        For an arm with strongly coupled joints, such as the ARAS arm, the iterative solver needs
        hundreds of sweeps per step, and the direct solver is faster. However, Bullet itself changes
        to the iterative solver in steps with contacts, and a body on the ground would shake at each
        change. Therefore World uses the direct solver only if all bases are fixed.
        """
        if direct == self._has_direct_solver:
            return
        self._has_direct_solver = direct
        solver = (pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG if direct
                  else pybullet.CONSTRAINT_SOLVER_LCP_SI)
        with silence_output():  # switching the solver makes Bullet print "switched solver"
            pybullet.setPhysicsEngineParameter(constraintSolverType=solver, physicsClientId=self.id)

    def count_bodies(self) -> int:
        """Return the number of bodies in Bullet."""
        return pybullet.getNumBodies(physicsClientId=self.id)

    def remove_bodies(self, count: int) -> None:
        """Remove all bodies but the first `count`."""
        for i in range(self.count_bodies() - 1, count - 1, -1):
            body = pybullet.getBodyUniqueId(i, physicsClientId=self.id)
            pybullet.removeBody(body, physicsClientId=self.id)

    def reset(self) -> None:
        """Remove all bodies and constraints, and reset all parameters to Bullet's defaults."""
        pybullet.resetSimulation(physicsClientId=self.id)
        self._has_direct_solver = False

    def close(self) -> None:
        """Release the client; a second call has no effect."""
        self._finalizer.detach()
        if self.id >= 0 and pybullet.isConnected(self.id):
            release_client(self.id, self.is_unused)
        self.id = -1
