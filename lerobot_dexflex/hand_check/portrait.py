"""Pictures of the hand from the front and the side, its pads and taxels marked."""

from pathlib import Path

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.rendering import Camera, tune_visuals
from lerobot_dexflex.evaluation.report.film import write_mp4
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.grasp_frame import grasp_frame
from lerobot_dexflex.hand.model import add_hand, base_spec
from lerobot_dexflex.hand_check.bench import sweep
from lerobot_dexflex.hands import Finger, Hand
from lerobot_dexflex.hands.tables import rotation_of

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_VIEWS = ("front", "side")
_FIELD_OF_VIEW = 30.0
_MARGIN = 0.02
_PICTURE_SIZE, _FILM_SIZE = 640, 320
_FRAMES_PER_JOINT = 16
_PAD, _TAXEL, _LAST_ROW = (0.3, 0.55, 0.96, 1), (0.95, 0.75, 0.2, 1), (0.88, 0.25, 0.2, 1)
_LINK, _INK = (0.55, 0.57, 0.6, 1), (235, 235, 235)


class Portrait:
    """Photographs the hand, fingers up: once facing what the fingers close on, once from their side.

    Args:
        hand: The hand.
        size: Width and height of a picture [pixels].
    """

    def __init__(self, hand: Hand, size: int) -> None:
        spec = base_spec()
        spec.visual.global_.offwidth = spec.visual.global_.offheight = size
        tune_visuals(spec)
        to_world = _upright(hand)
        w, x, y, z = _quaternion(to_world)
        add_hand(spec, spec.worldbody, hand, (0, 0, 0), (w, x, y, z))
        for geom in spec.geoms:
            geom.rgba = _LINK
        for finger in hand.fingers:
            _mark(hand, finger, spec.body(finger.distal))
        _add_cameras(spec, *_extent(hand, to_world))
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._cameras = [Camera(self._model, view, size, size) for view in _VIEWS]

    def take(self, joints: Array, title: str) -> Picture:
        """Return both views of a posture (joints,) [rad] side by side. Shape (size, 2 size, 3)."""
        self._data.qpos[:] = joints
        mujoco.mj_fwdPosition(self._model, self._data)
        picture = np.concatenate([camera.render(self._data) for camera in self._cameras], axis=1)
        cv2.putText(picture, title, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)
        return picture


def write_picture(hand: Hand, path: Path) -> None:
    """Write a picture of the relaxed and the nominal posture, each from the front and the side."""
    portrait = Portrait(hand, _PICTURE_SIZE)
    rows = [
        portrait.take(np.array(joints), f"{hand.name}, {title}: front and side")
        for joints, title in ((hand.relaxed_joints, "relaxed"), (hand.nominal_joints, "nominal"))
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(np.concatenate(rows), cv2.COLOR_RGB2BGR))


def write_film(hand: Hand, path: Path) -> None:
    """Write a film in which one joint after another goes through its range."""
    portrait = Portrait(hand, _FILM_SIZE)
    frames = (
        portrait.take(joints, f"{name}: {joints[k]:+.2f} rad")
        for k, (name, postures) in enumerate(
            zip(hand.joint_names, sweep(hand, _FRAMES_PER_JOINT), strict=True)
        )
        for joints in postures
    )
    write_mp4(path, frames, crf=23)


def _upright(hand: Hand) -> Array:
    """Return the rotation from the palm to a world in which the hand reaches up and closes toward -y."""
    toward, row, reach = grasp_frame(hand).axes.T
    return np.stack([row, -toward, reach])


def _quaternion(rotation: Array) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion


def _extent(hand: Hand, to_world: Array) -> tuple[Array, float]:
    """Return the centre of all postures [m] and the largest half extent of what is to be seen [m]: world."""
    postures = np.concatenate([*sweep(hand, 5), [hand.nominal_joints]])
    origins, _, _ = kernels.frames(hand.tables, postures)
    tips = kernels.fingertips(hand.tables, postures)
    points = np.vstack([np.zeros((1, 3)), origins.reshape(-1, 3), tips.reshape(-1, 3)]) @ to_world.T
    lower, upper = points.min(0), points.max(0)
    return (lower + upper) / 2, float((upper - lower).max()) / 2 + _MARGIN


def _add_cameras(spec: mujoco.MjSpec, centre: Array, half_extent: float) -> None:
    distance = half_extent * (1 + 1 / np.tan(np.radians(_FIELD_OF_VIEW) / 2))
    for view, away, right in zip(_VIEWS, ((0, -1, 0), (-1, 0, 0)), ((1, 0, 0), (0, -1, 0)), strict=True):
        spec.worldbody.add_camera(
            name=view,
            pos=centre + distance * np.array(away),
            quat=_quaternion(np.stack([right, (0.0, 0.0, 1.0), away], 1)),
            fovy=_FIELD_OF_VIEW,
        )


def _mark(hand: Hand, finger: Finger, body: mujoco.MjsBody) -> None:
    """Lay a sheet on the pad and a bead on every taxel, red in the row nearest the tip."""
    frame = rotation_of(finger.pad_quaternion)
    kept = {"contype": 0, "conaffinity": 0, "mass": 0}
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(*finger.pad_half_size, 0.0003),
        pos=finger.pad_position,
        quat=np.array(finger.pad_quaternion, float) / np.linalg.norm(finger.pad_quaternion),
        rgba=_PAD,
        **kept,
    )
    along, across = hand.taxels
    for i in range(along):
        for j in range(across):
            place = (np.array([i, j]) - [(along - 1) / 2, (across - 1) / 2]) * hand.taxel_pitch
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=(0.4 * min(hand.taxel_pitch), 0, 0),
                pos=np.array(finger.pad_position) + frame @ [*place, 0.0005],
                rgba=_LAST_ROW if i == along - 1 else _TAXEL,
                **kept,
            )
