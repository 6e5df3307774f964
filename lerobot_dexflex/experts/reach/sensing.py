"""What a privileged expert reads from a running `ReachEnv`, in few array operations."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.hand.grasp import OBJECT
from lerobot_dexflex.hand.model import FINGERS
from lerobot_dexflex.hand.poses import quaternion_matrix

Array = NDArray[np.float64]


class HandState(NamedTuple):
    """True state of hand and object after a control step; palm frame."""

    position: Array
    """Object position [m]. Shape (3,)."""
    quaternion: Array
    """Object orientation (w x y z). Shape (4,)."""
    rotation: Array
    """The same as a matrix. Shape (3, 3)."""
    centre: Array
    """Centre of mass of the object [m]. Shape (3,)."""
    tips: Array
    """Measured fingertips [m]. Shape (4, 3)."""
    joints: Array
    """Measured hand joints [rad]. Shape (16,)."""
    loads: Array
    """Normal force of each fingertip on the object [N]. Shape (4,)."""
    points: Array
    """Load-weighted contact points [m]; the fingertip where nothing is touched. Shape (4, 3)."""
    inward: Array
    """Unit contact normals into the object; zero where nothing is touched. Shape (4, 3)."""


class Senses:
    """Read one environment; make a new one after each reset, which builds another model."""

    def __init__(self, env: ReachEnv) -> None:
        self.env = env
        model = env.model
        self.mass = float(model.body(OBJECT).mass[0])
        self.friction = env.episode.object_spec.friction
        self._object = model.body(OBJECT).id
        self._finger = np.full(model.nbody, -1)
        for k, finger in enumerate(FINGERS):
            self._finger[model.body(f"{finger}_ds").id] = k
        self._tips = [model.site(f"{finger}_tip").id for finger in FINGERS]

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity [m/s^2]. Shape (3,)."""
        return self.env.model.opt.gravity.copy()

    def read(self) -> HandState:
        """Read the state; valid after `mj_forward`."""
        data = self.env.data
        position, quaternion = data.qpos[16:19].copy(), data.qpos[19:23].copy()
        tips = data.site_xpos[self._tips]
        loads, points, inward = np.zeros(4), tips.copy(), np.zeros((4, 3))
        contact = data.contact
        bodies = self.env.model.geom_bodyid[contact.geom]  # (contacts, 2)
        touching = np.flatnonzero((bodies == self._object).any(1) & (contact.efc_address >= 0))
        weighted = np.zeros((4, 3))
        for k in touching:
            second = bodies[k, 1] == self._object
            finger = self._finger[bodies[k, 0 if second else 1]]
            if finger < 0:
                continue
            force = data.efc_force[contact.efc_address[k]]
            loads[finger] += force
            weighted[finger] += force * contact.pos[k]
            inward[finger] += (force if second else -force) * contact.frame[k, :3]
        for finger in np.flatnonzero(loads > 1e-6):
            points[finger] = weighted[finger] / loads[finger]
            inward[finger] /= max(float(np.linalg.norm(inward[finger])), 1e-9)
        return HandState(
            position,
            quaternion,
            quaternion_matrix(quaternion),
            data.xipos[self._object].copy(),
            tips,
            data.qpos[:16].copy(),
            loads,
            points,
            inward,
        )
