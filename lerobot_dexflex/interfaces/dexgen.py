"""DexGen, the baseline: execute a sample of a diffusion prior that is guided toward the draft."""

import functools
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from lerobot_dexflex.controller import ControllerConfig, DexFlexController
from lerobot_dexflex.controller.diffusion_prior import STEPS, DiffusionPrior
from lerobot_dexflex.controller.finite import check_output
from lerobot_dexflex.conventions import STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.learned import LearnedInterface, file_stamps
from lerobot_dexflex.interfaces.registry import INTERFACES

GUIDANCE = 30.0
"""Strength of the guidance, the best of 3, 10, 30 and 100 on tuning objects (log in `eval/README.md`)."""
DENOISING_STEPS = 8


class DexGenInterface(LearnedInterface):
    """Sample one chunk, guided toward the draft, at every step and execute its first displacement as `raw`.

    DexGen's inverse dynamics model is the inverse kinematics here, exact by construction: every expert moved
    the hand through the same fingertip executor. Noise is the same in every row and step. Satisfies
    `Interface`; a draft of None is one that came too late.

    Args:
        controller: A controller's folder or hub id, the shipped one if None; or the controller itself, whose
            encoder is used, together with `prior`.
        prior: The diffusion prior; that of the controller's folder if None.
        guidance: Strength with which the draft pulls; 0 ignores it, infinite would be `raw`.
        steps: Denoising steps.
        use_touch: Whether the encoder sees touch.
        output_gain: Scale of the executed displacement.
        seed: Seed of the noise.
    """

    name: str = "dexgen"

    def __init__(
        self,
        controller: DexFlexController | str | Path | None = None,
        prior: DiffusionPrior | None = None,
        guidance: float = GUIDANCE,
        steps: int = DENOISING_STEPS,
        use_touch: bool = True,
        output_gain: float = 1.0,
        seed: int = 0,
    ) -> None:
        if guidance < 0 or output_gain < 0 or not 1 <= steps <= STEPS:
            raise DexFlexError(
                f"`guidance` and `output_gain` must not be negative, `steps` must be in [1, {STEPS}]. "
                f"Got {guidance}, {output_gain}, {steps}."
            )
        if prior is None:
            if isinstance(controller, DexFlexController):
                raise DexFlexError("Give `prior` together with a controller object, or the folder of both.")
            controller = find_controller(controller, INTERFACES["dexgen"].files)
        super().__init__(controller)
        if prior is None:
            assert isinstance(controller, Path)
            prior = _loaded_prior(controller.resolve(), file_stamps(controller))
        self.prior = prior.eval()
        self._guidance, self._steps, self._use_touch = guidance, steps, use_touch
        self._output_gain = output_gain
        width = self.controller.config.chunk_width
        self._noise = torch.randn(1, 1, width, generator=torch.Generator().manual_seed(seed))

    def _move(self, device: torch.device) -> None:
        super()._move(device)
        self.prior.to(device)

    @torch.no_grad()
    def step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        """Return the joint targets of the guided sample's first displacement; see `Interface.step`."""
        with self._all_or_nothing():
            targets = self._step(observation, draft)
        return targets.to(observation[STATE].dtype if draft is None else draft.dtype)

    def _step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        sensed = self._sense(observation, draft)
        history = sensed.history if self._use_touch else sensed.history.without_touch()
        prior, scale = self.prior, self.controller.scale
        context = prior.context(self.controller.encode(history))
        wanted = scale.normalize(sensed.draft.draft.float())
        noise = self._noise.to(wanted).expand(len(wanted), -1, -1)
        drawn = prior.sample(noise, wanted, self._guidance, self._steps, context)
        chunk = check_output("prior of DexGen", scale.restore(drawn))[:, 0]
        displacement = self._output_gain * chunk[:, 0].double()
        return self._execute(sensed, displacement, None, None)


@functools.cache
def _loaded_prior(folder: Path, stamps: tuple[tuple[str, int, int], ...]) -> DiffusionPrior:
    del stamps
    return DiffusionPrior.load(folder, ControllerConfig.load(folder / "config.json"))
