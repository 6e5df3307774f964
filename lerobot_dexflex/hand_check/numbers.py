"""Are limits and torques plausible numbers in rad and N m?"""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand_check.bench import Bench, random_postures
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_MARGIN, _MOST_AT_LIMITS = 0.02, 0.5
_LOAD = 0.1
_POSTURES = 64


def check_limits(hand: Hand) -> Finding:
    """Check that limits are angles in rad and that no posture pins a finger down at them."""
    limits = np.stack([hand.joint_lower, hand.joint_upper], 1)
    widest = int(np.abs(limits).max(1).argmax())
    joint = hand.joint_names[widest]
    found = f"widest limits {tuple(limits[widest].round(3).tolist())} rad at {joint}"
    passed = bool(np.abs(limits).max() <= 2 * math.pi)
    for posture in ("relaxed_joints", "nominal_joints", "idle_joints"):
        angles = np.array(getattr(hand, posture))
        at_limit = np.abs(limits - angles[:, None]).min(1) < _MARGIN
        for finger, own in zip(hand.finger_names, hand.finger_joints, strict=True):
            if at_limit[own].mean() > _MOST_AT_LIMITS:
                passed = False
                found += f"; {int(at_limit[own].sum())} joints of {finger} at their limits in `{posture}`"
    return Finding(
        "limits",
        passed,
        found,
        f"limits within a full turn; at most half the joints of a finger within {_MARGIN} rad of one",
        "Give `joint_range` in rad (degrees times pi/180), and postures from which the fingers can bend "
        "either way.",
    )


def check_strength(hand: Hand) -> Finding:
    """Check that every motor carries its links and 100 g at the fingertip, in any posture and direction."""
    bench, needed = Bench(hand), np.zeros(hand.n_joints)
    for joints in random_postures(hand, _POSTURES):
        bench.pose(joints)
        needed = np.maximum(needed, _torques(hand, bench.model, bench.data))
    torques = np.array([motor.torque for motor in hand.motors])
    sag = needed / hand.position_gains
    weakest = int((torques / needed).argmin())
    return Finding(
        "strength",
        bool((torques >= needed).all()),
        f"{hand.joint_names[weakest]} has {torques[weakest]:.3g} N m and needs {needed[weakest]:.3g}; "
        f"joints sag by {sag.max():.2f} rad at most",
        f"a `torque` that carries the finger's links and {_LOAD * 1000:.0f} g at its tip",
        "Give `torque` in N m and masses in kg; a hand that is really this weak cannot hold tools.",
    )


def _torques(hand: Hand, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the torque of links and load about each joint, gravity in its worst direction [N m]."""
    found = []
    for finger in hand.fingers:
        bodies = [model.body(link.name).id for link in finger.links]
        masses = np.array([*(link.inertia.mass for link in finger.links), _LOAD])
        places = np.vstack([data.xipos[bodies], data.site(f"{finger.prefix}_tip").xpos])
        for k, link in enumerate(finger.links):
            joint = model.joint(link.joint).id
            arms = np.cross(data.xaxis[joint], places[k:] - data.xanchor[joint])
            found.append(GRAVITY * np.linalg.norm(masses[k:] @ arms))
    return np.array(found)
