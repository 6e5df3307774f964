"""A hand written down by hand, and what each device would send of it.

Nothing here calls the code under test: packets are made with the axes' names, one by one.
"""

import copy
import json

import numpy as np
from numpy.typing import ArrayLike

HAND = 1e-3 * np.array(
    [
        (0, 0, 0),
        *[(22, 32, -8), (48, 58, -14), (68, 78, -18), (90, 94, -22)],
        *[(88, 22, 0), (128, 28, -6), (150, 31, -10), (168, 33, -16)],
        *[(90, 0, 0), (134, 1, -7), (160, 2, -11), (180, 3, -18)],
        *[(83, -20, 0), (124, -24, -7), (148, -26, -12), (166, -28, -19)],
        *[(74, -38, -4), (104, -46, -9), (122, -50, -13), (138, -54, -18)],
    ]
)
"""A right hand, open and slightly bent, in its wrist frame [m]. The knuckles of index, middle and ring lie in
the plane z = 0, that of the middle on the x axis."""
LEFT_HAND = HAND * (1, -1, 1)
PLACE = np.array([0.4, -0.3, 1.2])
LEFTWARD = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Fingers to the world's +y."""


def in_world(hand, turn: ArrayLike = LEFTWARD, place: ArrayLike = PLACE):
    return hand @ np.asarray(turn).T + np.asarray(place)


ROKOKO_NAMES = ["Hand"] + [
    finger + bone
    for finger in ("Thumb", "Index", "Middle", "Ring", "Little")
    for bone in ("Proximal", "Medial", "Distal", "Tip")
]


def rokoko_packet(world, hand="right", t=7.25, **meta):
    """World: x forward, y left, z up. Studio: X right, Y up, Z forward."""
    body = {
        hand + name: {
            "position": {"x": -float(y), "y": float(z), "z": float(x)},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }
        for name, (x, y, z) in zip(ROKOKO_NAMES, world, strict=True)
    }
    worn = {
        "hasGloves": True,
        "hasLeftGlove": hand == "left",
        "hasRightGlove": hand == "right",
        "hasBody": True,
    }
    actor = {"name": "Ann", "meta": worn | meta, "dimensions": {"totalHeight": 1.8}, "body": body}
    return {"version": "3,0", "fps": 60.0, "scene": {"timestamp": t, "actors": [actor], "props": []}}


def openxr_packet(world, hand="right", t=7.25, orientation=(0.0, 0.0, 0.0, 1.0)):
    """World: x forward, y left, z up. OpenXR: x right, y up, z backward. Orientation: the wrist's, xyzw."""
    points = [[-float(y), float(z), -float(x)] for x, y, z in world]
    joints = [[9.0, 9.0, 9.0]] * 26
    joints[1:6] = points[:5]
    for finger in range(4):
        joints[7 + 5 * finger : 11 + 5 * finger] = points[5 + 4 * finger : 9 + 4 * finger]
    turns = [[0.5, 0.5, 0.5, 0.5]] * 26
    turns[1] = list(orientation)
    return {
        "timestamp": round(t * 1e9),
        f"hand_{hand}": {"joint_positions": joints, "joint_orientations": turns},
    }


def mediapipe_packet(hands, t_ms=7250):
    """Hands: by label, in a frame x right, y down, z away from the camera."""
    landmarks = [np.asarray(points).tolist() for points in hands.values()]
    return {"timestamp_ms": t_ms, "handedness": list(hands), "hand_world_landmarks": landmarks}


def before_camera(hand):
    """Palm to the camera, fingers up: x of the hand is up in the image, y is to its right, z is away."""
    middle = hand.mean(0)
    return np.stack([hand[:, 1] - middle[1], middle[0] - hand[:, 0], hand[:, 2] - middle[2]], axis=1)


def sent(packet):
    return json.dumps(packet).encode()


def broken_copies(packet, values=(None, "x", [], {}, 1e200, 1e400, 10**400, True, [[1.0]])):
    """Yield the packet with one of its nodes replaced, for every node."""
    for path in _paths(packet):
        for value in values:
            copied = copy.deepcopy(packet)
            *parents, last = path
            node = copied
            for step in parents:
                node = node[step]
            node[last] = value
            yield copied


def _paths(node, path=()):
    steps = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for step, child in steps:
        yield (*path, step)
        yield from _paths(child, (*path, step))
