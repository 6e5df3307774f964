"""Film episodes, and lay the films of several interfaces side by side."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.evaluation.outcome import Ended, Motion
from lerobot_dexflex.hand.touch_image import FULL_SCALE, touch_strip
from lerobot_dexflex.hands import Hand

STRIDE = 2
"""Every second control step is filmed ..."""
FPS = 20
"""... and played at this rate: films of 20 Hz control run at twice real time."""
_FRONT, _WRIST, _TITLE, _STRIP = 192, 96, 20, 76
_COLOURS = {"success": (70, 190, 110), "dropped": (225, 95, 85), "time out": (215, 165, 60)}
_BACKGROUND, _GREY = (24, 26, 30), (150, 155, 165)


class Film:
    """Films one episode: front and wrist camera, touch below, a title with interface and outcome.

    Args:
        path: The mp4 file; its folder is created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames: list[NDArray[np.uint8]] = []
        self._step = 0
        self._seconds = 0.0

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """Keep a frame of every second step."""
        del info, motion
        if self._step % STRIDE == 0:
            self._frames.append(_frame(env, observation))
        self._seconds = self._step / env.metadata["render_fps"]
        self._step += 1

    def close(self, outcome: Ended) -> None:
        """Write the film with the outcome in its title."""
        title = f"{outcome.interface} - episode {outcome.episode} - {outcome.ending} ({self._seconds:.1f} s)"
        band = _title(title, self._frames[0].shape[1], _COLOURS[outcome.ending])
        write_mp4(self._path, (np.concatenate([band, frame]) for frame in self._frames), crf=20)


def side_by_side(films: Sequence[Path], path: Path) -> None:
    """Write films next to each other; ended ones show their last frame.

    Raises:
        ValueError: If there are no films.
    """
    clips = [read_mp4(film) for film in films]
    length = max(len(clip) for clip in clips)
    gap = np.full((clips[0].shape[1], 6, 3), _BACKGROUND, np.uint8)
    rows = ([clip[min(k, len(clip) - 1)] for clip in clips] for k in range(length))
    write_mp4(path, (np.concatenate([p for f in row for p in (f, gap)][:-1], axis=1) for row in rows), crf=28)


def write_mp4(path: Path, frames: Iterable[NDArray[np.uint8]], crf: int) -> None:
    """Write RGB frames (height, width, 3) of even size as h264, which every browser plays."""
    import av
    import av.logging

    av.logging.set_level(av.logging.PANIC)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    options = {"crf": str(crf), "preset": "slow"}
    with av.open(str(temporary), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("h264", rate=FPS, options=options)
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            stream.height, stream.width = frame.shape[:2]
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24"))
            )
        container.mux(stream.encode())
    temporary.replace(path)


def read_mp4(path: Path) -> NDArray[np.uint8]:
    """Return all frames. Shape (frames, height, width, 3)."""
    import av

    frames = []
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return np.stack(frames).astype(np.uint8)


def _frame(env: gymnasium.Env, observation: Any) -> NDArray[np.uint8]:
    """Compose one picture, shape (268, 288, 3)."""
    canvas = np.full((_FRONT + _STRIP, _FRONT + _WRIST, 3), _BACKGROUND, np.uint8)
    canvas[:_FRONT, :_FRONT] = _resized(np.asarray(env.render(), np.uint8), _FRONT)
    pixels = observation["pixels"]
    if "wrist" in pixels:
        canvas[:_WRIST, _FRONT:] = _resized(pixels["wrist"], _WRIST)
    hand: Hand = env.get_wrapper_attr("hand")
    pairs = [", ".join(hand.finger_names[k : k + 2]) for k in range(0, hand.n_fingers, 2)]
    legend = ("wrist camera", "", f"touch, 0-{FULL_SCALE:g} N:", *",\n".join(pairs).split("\n"))
    for line, text in enumerate(legend):
        _write(canvas, text, (_FRONT + 5, _WRIST + 14 + (0 if line == 0 else 86 + 14 * (line - 2))), _GREY)
    strip = touch_strip(hand, observation["tactile"])
    height = min(_STRIP - 8, int(strip.shape[0] * _FRONT / strip.shape[1]))
    width = round(strip.shape[1] * height / strip.shape[0])
    small = cv2.resize(strip, (width, height), interpolation=cv2.INTER_NEAREST)
    canvas[_FRONT + 4 : _FRONT + 4 + height, _FRONT - width : _FRONT] = small
    return canvas


def _resized(picture: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    shrinks = picture.shape[0] > size
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LANCZOS4
    return cv2.resize(picture, (size, size), interpolation=how).astype(np.uint8)


def _title(text: str, width: int, colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    band = np.full((_TITLE, width, 3), _BACKGROUND, np.uint8)
    _write(band, text, (6, 14), colour)
    return band


def _write(
    canvas: NDArray[np.uint8], text: str, origin: tuple[int, int], colour: tuple[int, int, int]
) -> None:
    cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.35, colour, 1, cv2.LINE_AA)
