"""Threads: bodies that sink as they are turned clockwise, and one that catches a free body for that."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hands.body import Vector3

_STIFF = (2 * robot.TIMESTEP, 1.0)


def add_thread(
    spec: mujoco.MjSpec,
    position: Vector3,
    pitch: float,
    turns: float,
    friction: float,
    caught: str,
    offset: float,
) -> mujoco.MjsBody:
    """Add a thread and the weld by which it catches a body; return what turns and sinks, the body `core`.

    MuJoCo has no helical contacts: a hinge and a slide are coupled by an equality, and friction of the hinge
    makes the thread self-locking. Its frame is a mocap body, which takes the caught body's yaw: so everything
    about the thread is state.

    Args:
        spec: The scene.
        position: Of the thread's first turn, world frame [m].
        pitch: How far a turn sinks [m].
        turns: After how many it is tight.
        friction: Torque that turns it [N m].
        caught: Name of the body that it catches.
        offset: How far above the first turn that body's origin is then [m].
    """
    frame = spec.worldbody.add_body(name="thread", pos=position, mocap=True)
    core = frame.add_body(name="core")
    core.mass, core.inertia, core.explicitinertial, core.gravcomp = 0.01, (1e-5, 1e-5, 1e-5), True, 1.0
    add_lead(spec, core, "thread", pitch, turns, friction, 0.1)
    catch = spec.add_equality(name="thread_catch", type=mujoco.mjtEq.mjEQ_WELD, name1="core", name2=caught)
    catch.objtype = mujoco.mjtObj.mjOBJ_BODY
    catch.active = False
    catch.data[:11] = (0, 0, 0, 0, 0, offset, 1, 0, 0, 0, 1)
    catch.solref = _STIFF
    return core


def add_lead(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    pitch: float,
    turns: float,
    friction: float,
    play: float,
) -> mujoco.MjsJoint:
    """Let a body sink as it is turned clockwise, until it is tight; return the joint that turns.

    Args:
        spec: The scene.
        body: What turns, by the joint `<name>_turn`, and sinks, by `<name>_slide`.
        name: Of the thread.
        pitch: How far a turn sinks [m].
        turns: After how many it is tight.
        friction: Torque that turns it [N m].
        play: How far it turns back out [rad].
    """
    # Without it the turn-slide coupling is about 1000 times too soft: the diagonal approximation adds the
    # hinge's inverse inertia without the squared ratio.
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_DIAGEXACT)
    turn = body.add_joint(name=f"{name}_turn", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1))
    turn.frictionloss, turn.armature, turn.damping[0] = friction, 2e-4, 0.002
    turn.range, turn.limited, turn.solref_limit = (-2 * np.pi * turns, play), True, _STIFF
    slide = body.add_joint(name=f"{name}_slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1))
    slide.armature = 0.05
    coupling = spec.add_equality(
        name=f"{name}_lead", type=mujoco.mjtEq.mjEQ_JOINT, name1=slide.name, name2=turn.name
    )
    coupling.objtype = mujoco.mjtObj.mjOBJ_JOINT
    coupling.data[:5] = (0, pitch / (2 * np.pi), 0, 0, 0)
    coupling.solref = _STIFF
    return turn


def has_caught(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Say whether the thread holds its body."""
    return bool(data.eq_active[model.equality("thread_catch").id])


def turns_in(data: mujoco.MjData, name: str = "thread") -> float:
    """Return by how many turns the thread of a name has been screwed in."""
    return max(0.0, -float(data.joint(f"{name}_turn").qpos[0]) / (2 * np.pi))


def catch(model: mujoco.MjModel, data: mujoco.MjData, rotation: NDArray[np.float64]) -> None:
    """Turn the thread to the yaw of a body (3, 3) and weld it on: all of it state that snapshots carry."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    data.mocap_quat[model.body("thread").mocapid[0]] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    data.joint("thread_turn").qpos[:] = data.joint("thread_turn").qvel[:] = 0
    data.joint("thread_slide").qpos[:] = data.joint("thread_slide").qvel[:] = 0
    data.eq_active[model.equality("thread_catch").id] = 1
    mujoco.mj_forward(model, data)
