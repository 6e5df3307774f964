"""Demonstrate BrushSweep: grip the brush as it lies, turn it straight in the hand, sweep stroke by stroke."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.envs.brush_sweep import (
    ARM_START,
    BRISTLE_END,
    BRISTLE_HALF_DEPTH,
    HANDLE_HALF_DEPTH,
    HANDLE_HALF_LENGTH,
    HEAD_CENTRE,
    HEAD_HALF_SIZE,
    LIP_DEPTH,
    LIP_HEIGHT,
    PAN_HALF_WIDTH,
    BrushSweepEnv,
)
from lerobot_dexflex.experts.command import Command, min_jerk
from lerobot_dexflex.experts.tool.bar import HELD, pick_up
from lerobot_dexflex.experts.tool.grip import all_fingers, without
from lerobot_dexflex.experts.tool.hand import MARGIN, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.objects import ObjectSpec

GRASP_AT = 0.010
"""Where along the handle the hand grips, from its centre toward the head [m]."""
ALL_FINGERS = 0.6
"""How often all fingers take part; else the second does not."""
PRESS = 0.002
"""How deep the bristles are led into table and pan [m]."""
SCRAPE = np.array([-0.9, 0.0, 1.0])
"""Force of table and pan on the bristles that the hand braces for, working frame [N]."""
STROKES = 4
"""After so many the operator gives up."""
SWEEP_TO = -0.045
"""Where a stroke ends, y in the pan's frame [m]."""
RUN_UP = 0.025
"""Before it the bristles come down in motion: from rest they would stick [m]."""
SWEEP_SPEED = 0.006
"""Mean speed of a stroke [m] per control step."""
REACH = HEAD_HALF_SIZE[2] - 0.007
"""Pieces so far beside the middle of a stroke are taken along [m]."""


def demonstrate(env: BrushSweepEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Yield the demonstration of the episode that `env` has just been reset to.

    Privileged: reads the true pose of the brush and of every piece. The caller executes `Command.executed`
    before it asks for the next command.
    """
    episode, holds = env.episode, holds_of(env.hand)
    hold = holds.bar
    half_size = (HANDLE_HALF_DEPTH, episode.handle_half_width, HANDLE_HALF_LENGTH)
    shape = ObjectSpec("box", half_size, episode.mass)
    senses = ToolSenses(env, Tool("brush", shape, np.zeros(3), episode.tip_friction))
    hand = OperatorHand(senses, env.command, rng, rng.uniform(*MARGIN), holds.frame)
    script = Script(env, hand, rng, hold.centre)
    position, rotation = env.brush_pose
    grasp_point = position + rotation @ np.array([0.0, 0.0, GRASP_AT])
    held = Pose(hold.centre - GRASP_AT * HELD[:, 2], HELD)
    fingers = all_fingers(env.hand) if rng.random() < ALL_FINGERS else without(env.hand, 1)
    grip = hold.grip(PALM_DOWN.T @ rotation[:, 2], episode.handle_half_width, fingers)

    yield from pick_up(script, grip, grasp_point, held, ARM_START)
    yield from script.glide(script.position + np.array([0, 0, 0.05]), PALM_DOWN, 10)

    script.care = 0.4
    along, start = _next_stroke(env)
    yield from script.swing(*script.palm_for(held, *_brush_at(env, along, start, 0.06)), 24, ARM_START)
    yield from script.wait(lambda: hand.there, 20)
    script.care = 0.08
    for _ in range(STROKES):
        yield from _sweep(env, script, along, start)
        yield from script.hold(14)
        above = script.position + np.array([0, 0, 0.05])
        yield from script.glide(above, script.rotation, 8)
        along, start = _next_stroke(env)
        held = script.in_palm(*env.brush_pose)
        yield from script.glide(*script.palm_for(held, *_brush_at(env, along, start, 0.06)), 20)


def _sweep(env: BrushSweepEnv, script: Script, along: float, start: float) -> Iterator[Command]:
    """Lower the bristles in motion behind the pieces and sweep them over the lip."""
    held = script.in_palm(*env.brush_pose)
    yield from script.glide(*script.palm_for(held, *_brush_at(env, along, start + RUN_UP, 0.01)), 10)
    bristles = np.array([BRISTLE_END, 0.0, HEAD_CENTRE])
    script.hand.brace(SCRAPE, bristles)
    way = start + RUN_UP - SWEEP_TO
    steps = round(way / SWEEP_SPEED)
    for k in range(1, steps + 1):
        ahead = SWEEP_TO + (1 - min_jerk(k / steps)) * way
        above = 0.01 * np.clip((ahead - start) / RUN_UP, 0, 1)
        over_lip = LIP_HEIGHT * np.clip((BRISTLE_HALF_DEPTH - ahead) / LIP_DEPTH, 0, 1)
        yield script.step(*script.palm_for(held, *_brush_at(env, along, ahead, above + over_lip - PRESS)))
    script.hand.brace(np.zeros(3), bristles)


def _next_stroke(env: BrushSweepEnv) -> tuple[float, float]:
    """Return the stroke that takes most of the pieces left: x and first y in the pan's frame [m]."""
    pieces, inside = env.pieces_in_pan_frame()
    left = pieces[~inside] if not inside.all() else pieces
    widest = PAN_HALF_WIDTH - HEAD_HALF_SIZE[2] - 0.008
    strokes = np.linspace(-widest, widest, 9)
    beside = np.abs(left[:, 0] - strokes[:, None])  # (strokes, pieces)
    taken = (beside < REACH).sum(1) - beside.mean(1)
    return float(strokes[taken.argmax()]), float(left[:, 1].max() + BRISTLE_HALF_DEPTH + 0.012)


def _brush_at(env: BrushSweepEnv, along: float, ahead: float, height: float) -> Pose:
    """Return the level brush's pose whose bristles end over a point of the pan's frame [m]."""
    position, turn = env.pan_pose
    rotation = turn @ np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    end = position + turn @ np.array([along, ahead, height])
    return Pose(end - rotation @ np.array([BRISTLE_END, 0.0, HEAD_CENTRE]), rotation)
