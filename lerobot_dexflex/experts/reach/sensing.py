"""What a privileged expert reads from a running `ReachEnv`, in few array operations."""

from typing import Any, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.hand.grasp import OBJECT
from lerobot_dexflex.hand.poses import quaternion_matrix
from lerobot_dexflex.hand.surfaces import surface_samples
from lerobot_dexflex.hands import Hand

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
    """Measured fingertips [m]. Shape (fingers, 3)."""
    joints: Array
    """Measured hand joints [rad]. Shape (joints,)."""
    loads: Array
    """Normal force of each fingertip on the object [N]. Shape (fingers,)."""
    points: Array
    """Load-weighted contact points [m]; the fingertip where nothing is touched. Shape (fingers, 3)."""
    inward: Array
    """Unit contact normals into the object; zero where nothing is touched. Shape (fingers, 3)."""


class ObjectSenses(Protocol):
    """What the operator must know of a task: of `Reach-v0` (`Senses`) or with a tool (`ToolSenses`)."""

    hand: Hand
    """Of the task."""
    env: Any
    """The running environment, unwrapped."""
    mass: float
    """Of the object [kg]."""
    friction: float
    """Sliding friction of the fingertips on it."""

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity, palm frame [m/s^2]. Shape (3,)."""
        ...

    def surface(self, n: int) -> tuple[Array, Array]:
        """Return points [m] and outward normals of the object in its frame, each (n, 3)."""
        ...

    def read(self) -> HandState:
        """Read the state; valid after `mj_forward`."""
        ...


class FingerContacts:
    """Adds up what the fingertips do to a body, in the world frame.

    Args:
        hand: Whose fingertips.
        model: Of the running task.
        body: Number of the body.
    """

    def __init__(self, hand: Hand, model: mujoco.MjModel, body: int) -> None:
        self._fingers = hand.n_fingers
        self._model, self._body = model, body
        self._finger = np.full(model.nbody, -1)
        for k, name in enumerate(hand.distal_links):
            self._finger[model.body(name).id] = k

    def sums(self, data: mujoco.MjData) -> tuple[Array, Array, Array]:
        """Return normal forces [N] (fingers,), and contact points [m] and normals weighted by them.

        Points and normals have shape (fingers, 3); normals are unit vectors into the body.
        """
        loads = np.zeros(self._fingers)
        weighted, inward = np.zeros((self._fingers, 3)), np.zeros((self._fingers, 3))
        contact = data.contact
        bodies = self._model.geom_bodyid[contact.geom]  # (contacts, 2)
        for k in np.flatnonzero((bodies == self._body).any(1) & (contact.efc_address >= 0)):
            second = bodies[k, 1] == self._body
            finger = self._finger[bodies[k, 0 if second else 1]]
            if finger < 0:
                continue
            force = data.efc_force[contact.efc_address[k]]
            loads[finger] += force
            weighted[finger] += force * contact.pos[k]
            inward[finger] += (force if second else -force) * contact.frame[k, :3]
        return loads, weighted, inward


class Senses:
    """Read one environment; make a new one after each reset, which builds another model."""

    def __init__(self, env: ReachEnv) -> None:
        self.env, self.hand = env, env.hand
        model = env.model
        self.mass = float(model.body(OBJECT).mass[0])
        self.friction = env.episode.object_spec.friction
        self._object = model.body(OBJECT).id
        self._contacts = FingerContacts(self.hand, model, self._object)
        self._tips = [model.site(f"{finger}_tip").id for finger in self.hand.prefixes]

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity [m/s^2]. Shape (3,)."""
        return self.env.model.opt.gravity.copy()

    def surface(self, n: int) -> tuple[Array, Array]:
        """Return points [m] and outward normals of the object in its frame, each (n, 3)."""
        return surface_samples(self.env.episode.object_spec, n, np.random.default_rng(0))

    def read(self) -> HandState:
        """Read the state; valid after `mj_forward`."""
        data = self.env.data
        joints, pose = np.split(data.qpos[: self.hand.n_joints + 7], [self.hand.n_joints])
        position, quaternion = pose[:3].copy(), pose[3:].copy()
        tips = data.site_xpos[self._tips]
        loads, weighted, inward = self._contacts.sums(data)
        points = tips.copy()
        for finger in np.flatnonzero(loads > 1e-6):
            points[finger] = weighted[finger] / loads[finger]
            inward[finger] /= max(float(np.linalg.norm(inward[finger])), 1e-9)
        return HandState(
            position,
            quaternion,
            quaternion_matrix(quaternion),
            data.xipos[self._object].copy(),
            tips,
            joints.copy(),
            loads,
            points,
            inward,
        )
