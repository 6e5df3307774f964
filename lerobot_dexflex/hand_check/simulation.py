"""Do the motors move the hand, and does it hold an object?"""

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.grasp import OBJECT, Grasp, GraspSearch
from lerobot_dexflex.hand.grasp_candidates import GRAVITY
from lerobot_dexflex.hand.model import SUBSTEPS
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand_check.bench import POSTURES, Bench
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_MOVE_STEPS, _SETTLE_STEPS = 20, 10
_MOST_OFF = 0.05
OBJECTS = (
    ObjectSpec("box", (0.02, 0.025, 0.025), 0.06),
    ObjectSpec("cylinder", (0.022, 0.03), 0.06),
    ObjectSpec("capsule", (0.022, 0.015), 0.06),
)
"""Small objects, easily held: 4 to 7 cm, 60 g."""
_TRIES, _HOLD_STEPS = 100, 60
_MOST_DRIFT = 0.005
_ENOUGH = 5


def check_motors(hand: Hand) -> Finding:
    """Check in simulation that the motors take the hand to its postures within a second and keep it there."""
    bench, off = Bench(hand), np.zeros(hand.n_joints)
    start = np.array(hand.relaxed_joints)
    bench.pose(start)
    for posture in POSTURES:
        end = np.array(getattr(hand, posture))
        for share in [*np.linspace(0, 1, _MOVE_STEPS), *[1.0] * _SETTLE_STEPS]:
            bench.data.ctrl[:] = start + share * (end - start)
            mujoco.mj_step(bench.model, bench.data, SUBSTEPS)
        start = end
        off = np.maximum(off, np.abs(bench.data.qpos - end))
    worst = int(off.argmax())
    return Finding(
        "motors",
        bool(off[worst] <= _MOST_OFF),
        f"{hand.joint_names[worst]} is {off[worst]:.3f} rad off its target after a second and a half",
        f"{_MOST_OFF} rad or less",
        "Raise `position_gain` above `friction_loss`, or give `armature` and inertias in kg m^2: joints that "
        "weigh nothing shake.",
    )


def check_holding(hand: Hand) -> Finding:
    """Check that grasps of small objects are found, in six directions of gravity, and hold for 3 s."""
    drifts = [drift for drift in _drifts(hand) if drift is not None]
    held = [drift for drift in drifts if drift <= _MOST_DRIFT]
    told = f", drifting by {1000 * max(held):.1f} mm at most" if held else ""
    return Finding(
        "holding",
        len(held) >= _ENOUGH,
        f"of 6 objects of 60 g {len(drifts)} were grasped and {len(held)} held for 3 s{told}",
        f"{_ENOUGH} or more, drifting by {1000 * _MOST_DRIFT:.0f} mm or less",
        "See to the failed checks first. Then look at `object_region`, `pad_spacing`, `finger_order`, "
        "`nominal_joints` and `idle_joints`: the search lays three pads or more on the object.",
    )


def _drifts(hand: Hand) -> Iterator[float | None]:
    """Yield how far each object drifts [m]; None where no grasp is found."""
    for k, gravity in enumerate((*np.eye(3), *-np.eye(3))):
        search = GraspSearch(hand, OBJECTS[k % len(OBJECTS)], gravity)
        try:
            grasp = search.find(np.random.default_rng(k), tries=_TRIES)
        except DexFlexError:
            yield None
        else:
            yield _drift(search, grasp)


def _drift(search: GraspSearch, grasp: Grasp) -> float:
    """Return how far the object moves while the joint command stays as it is [m]."""
    model, data = search.model, search.data
    mujoco.mj_resetData(model, data)
    data.qpos[:] = (*grasp.hand_joints, *grasp.position, *grasp.quaternion)
    data.ctrl[:] = grasp.joint_targets
    model.opt.gravity = GRAVITY * search.gravity
    mujoco.mj_step(model, data, _HOLD_STEPS * SUBSTEPS)
    return float(np.linalg.norm(data.body(OBJECT).xpos - grasp.position))
