"""What the operator of a tool reads from a running task: everything, in the frame of the moving palm."""

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.sensing import FingerContacts, HandState
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.surfaces import surface_samples
from lerobot_dexflex.hands import PALM, Hand

Array = NDArray[np.float64]


class Tool(NamedTuple):
    """What of a body is gripped."""

    body: str
    """Name of the body."""
    grip: ObjectSpec
    """Shape of the part that is gripped, its long axis along z."""
    centre: Array
    """Where that part's centre is in the body's frame [m]. Shape (3,)."""
    friction: float
    """Sliding friction of the fingertips."""


class ToolSenses:
    """Read one running task; make a new one after each reset, which builds another model.

    Args:
        env: The task's environment, unwrapped.
        tool: What is gripped.
    """

    def __init__(self, env: Any, tool: Tool) -> None:
        self.env, self.tool, self.friction = env, tool, tool.friction
        self.hand: Hand = env.hand
        model = env.model
        self._body = model.body(tool.body).id
        self.mass = float(model.body_subtreemass[self._body])
        self._palm = model.body(PALM).id
        self._contacts = FingerContacts(self.hand, model, self._body)
        self._tips = [model.site(f"{finger}_tip").id for finger in self.hand.prefixes]
        self._joints = [model.joint(name).qposadr[0] for name in self.hand.joint_names]

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity in the palm frame [m/s^2]. Shape (3,)."""
        return self.env.data.xmat[self._palm].reshape(3, 3).T @ self.env.model.opt.gravity

    def surface(self, n: int) -> tuple[Array, Array]:
        """Return points [m] and outward normals of the gripped part in its own frame, each (n, 3)."""
        return surface_samples(self.tool.grip, n, np.random.default_rng(0))

    def read(self) -> HandState:
        """Read the state, the tool's as that of the gripped part; valid after `mj_forward`."""
        data = self.env.data
        palm, origin = data.xmat[self._palm].reshape(3, 3), data.xpos[self._palm]
        body = data.xmat[self._body].reshape(3, 3)
        rotation = palm.T @ body
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
        tips = (data.site_xpos[self._tips] - origin) @ palm
        loads, weighted, inward = self._contacts.sums(data)
        points = tips.copy()
        for finger in np.flatnonzero(loads > 1e-6):
            points[finger] = (weighted[finger] / loads[finger] - origin) @ palm
            normal = inward[finger] @ palm
            inward[finger] = normal / max(float(np.linalg.norm(normal)), 1e-9)
        inward[loads <= 1e-6] = 0.0
        return HandState(
            palm.T @ (data.xpos[self._body] + body @ self.tool.centre - origin),
            quaternion,
            rotation,
            palm.T @ (data.xipos[self._body] - origin),
            tips,
            data.qpos[self._joints].copy(),
            loads,
            points,
            inward,
        )
