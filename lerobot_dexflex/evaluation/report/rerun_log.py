"""Log an episode as a rerun recording: images, taxels, drafts against selected motions, success."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.evaluation.outcome import Ended, Motion
from lerobot_dexflex.hand.touch_image import FULL_SCALE
from lerobot_dexflex.hands import Hand

_DRAFT, _SELECTED, _MEASURED = (235, 150, 50), (70, 140, 240), (150, 150, 150)


class RerunLog:
    """Writes one `.rrd` file; files of the same episode open as one recording, one branch per interface.

    Args:
        path: The recording; its folder is created. None shows it in rerun's viewer, and opens that.
        interface: Root of the entity paths.
        episode: Episode, names the recording.
    """

    def __init__(self, path: Path | None, interface: str, episode: int) -> None:
        import rerun as rr

        self._rr, self._root, self._step = rr, interface, 0
        self._stream = rr.RecordingStream("lerobot_dexflex", recording_id=f"episode-{episode:04d}")
        if path is None:
            self._stream.spawn()
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(path)
        self._tips: NDArray[np.floating] = np.zeros((0, 3))

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """Log the state after a step."""
        rr = self._rr
        self._stream.set_time("step", sequence=self._step)
        self._stream.set_time("time", duration=self._step / env.metadata["render_fps"])
        for camera, image in observation["pixels"].items():
            self._log(f"camera/{camera}", rr.Image(image))
        hand: Hand = env.get_wrapper_attr("hand")
        self._log("touch", self._touch(hand, observation["tactile"]))
        for finger, force in zip(hand.prefixes, _forces(hand, observation), strict=True):
            self._log(f"touch_force/{finger}", rr.Scalars(force))
        self._log("progress", rr.Scalars(float(info["progress"])))
        self._log("success", rr.Scalars(float(info["is_success"])))
        if motion is not None:
            self._log_motion(motion)
        self._tips = np.asarray(observation["fingertips"]).reshape(-1, 3)
        self._log("palm/measured", rr.Points3D(self._tips, colors=_MEASURED, radii=0.004))
        self._step += 1

    def scalars(self, values: Mapping[str, float]) -> None:
        """Log numbers of the step that was watched last, by entity path."""
        for entity, value in values.items():
            self._log(entity, self._rr.Scalars(value))

    def close(self, outcome: Ended) -> None:
        """Add the outcome and finish the file."""
        self._log("outcome", self._rr.TextLog(f"{outcome.ending} after {outcome.steps} steps"))
        self._stream.flush()
        self._stream.disconnect()

    def _log_motion(self, motion: Motion) -> None:
        rr = self._rr
        for name, vectors, colour in (
            ("draft", motion.draft, _DRAFT),
            ("selected", motion.selected, _SELECTED),
        ):
            # Both lead from where the fingertips were measured before the step.
            arrows = rr.Arrows3D(origins=self._tips, vectors=10 * vectors, colors=colour, radii=0.001)
            self._log(f"palm/{name}", arrows)
        self._log("intervention", rr.Scalars(motion.magnitude()))

    def _touch(self, hand: Hand, tactile: NDArray[np.floating]) -> Any:
        """Return the pads side by side, each with its tip up, coloured by the viewer, who tells newtons.

        A picture made here, as in films, takes OpenCV 20 ms: too long beside a control step.
        """
        pads = np.asarray(tactile, np.float32).reshape(hand.n_fingers, *hand.taxels)[:, ::-1]
        strip = np.pad(pads, ((0, 0), (0, 0), (0, 1))).swapaxes(0, 1).reshape(hand.taxels[0], -1)
        colours = self._rr.components.Colormap.Inferno
        return self._rr.DepthImage(strip, meter=1.0, colormap=colours, depth_range=(0.0, FULL_SCALE))

    def _log(self, entity: str, value: Any) -> None:
        self._stream.log(f"{self._root}/{entity}", value)


def _forces(hand: Hand, observation: Any) -> list[float]:
    """Return the summed taxel force of each finger [N]."""
    return [float(f) for f in np.asarray(observation["tactile"]).reshape(hand.n_fingers, -1).sum(1)]
