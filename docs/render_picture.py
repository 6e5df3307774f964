"""Render docs/place_hammer.png: four moments of a demonstration, each above what the fingertips feel.

python docs/render_picture.py
"""

from pathlib import Path

import cv2
import gymnasium
import numpy as np
from numpy.typing import NDArray

import lerobot_dexflex  # noqa: F401  (registers the tasks)
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.hand.touch import touch_strip
from lerobot_dexflex.hands import LEAP

TASK, SEED = "PlaceHammer-v0", 3
MOMENTS = (36, 90, 152, 185)
"""Control steps shown: before the grasp, on the way, hanging, let go."""
SIZE, SUPERSAMPLING = 300, 4


def panel(picture: NDArray[np.uint8], tactile: NDArray) -> NDArray[np.uint8]:
    """Return the camera's picture above the touch of the four fingertips."""
    view = cv2.resize(picture, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    strip = touch_strip(LEAP, tactile)
    height = SIZE * strip.shape[0] // strip.shape[1]
    felt = cv2.resize(strip, (SIZE, height), interpolation=cv2.INTER_NEAREST)
    return np.concatenate([view, felt]).astype(np.uint8)


def main() -> None:
    """Run the expert and save the chosen moments side by side."""
    size = SIZE * SUPERSAMPLING
    env = gymnasium.make(f"lerobot_dexflex/{TASK}", cameras=(), render_size=size).unwrapped
    assert isinstance(env, HandEnv)
    observation, info = env.reset(seed=SEED)
    panels, step = [], 0
    for step, command in enumerate(make_expert(TASK)(env, np.random.default_rng(SEED))):
        picture = env.render() if step in MOMENTS else None
        if picture is not None:
            panels.append(panel(picture, observation["tactile"]))
        observation, _, done, _, info = env.step(command.executed)
        if done:
            break
    print(f"success: {info['is_success']} after {step + 1} steps")
    gap = np.full((len(panels[0]), 6, 3), 255, np.uint8)
    columns = [part for image in panels for part in (image, gap)][:-1]
    picture = cv2.cvtColor(np.concatenate(columns, axis=1), cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(Path(__file__).with_name("place_hammer.png")), picture)


if __name__ == "__main__":
    main()
