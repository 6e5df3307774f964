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
from lerobot_dexflex.hand.kinematics import joint_limits, solve_fingertips
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.learned import LearnedInterface, file_stamps
from lerobot_dexflex.interfaces.registry import INTERFACES

GUIDANCE = 30.0
"""Strength of the guidance (log in `eval/LOG.md`)."""
DENOISING_STEPS = 8


class DexGenInterface(LearnedInterface):
    """Sample one chunk, guided toward the draft, at every step; inverse dynamics turn it into joint targets.

    Free fingers follow the draft instead, by inverse kinematics. Noise is the same in every row and step.
    Satisfies `Interface`; a draft of None is one that came too late.

    Args:
        hand: The hand that it serves.
        controller: A controller's folder or hub id, the shipped one if None; or the controller itself, whose
            encoder is used, together with `prior`.
        prior: The diffusion prior; that of the controller's folder if None.
        guidance: Strength with which the draft pulls; 0 ignores it, infinite would be `raw`.
        steps: Denoising steps.
        use_touch: Whether the encoder sees touch.
        use_splitter: Whether a draft's squeeze is taken out of it, for sources that press.
        seed: Seed of the noise.
    """

    name: str = "dexgen"

    def __init__(
        self,
        hand: Hand,
        controller: DexFlexController | str | Path | None = None,
        prior: DiffusionPrior | None = None,
        guidance: float = GUIDANCE,
        steps: int = DENOISING_STEPS,
        use_touch: bool = True,
        use_splitter: bool = False,
        seed: int = 0,
    ) -> None:
        if not guidance >= 0 or not 1 <= steps <= STEPS:
            raise DexFlexError(
                f"`guidance` must not be negative, `steps` must be in [1, {STEPS}]. Got {guidance}, {steps}."
            )
        if prior is None:
            if isinstance(controller, DexFlexController):
                raise DexFlexError("Give `prior` together with a controller object, or the folder of both.")
            controller = find_controller(hand, controller, INTERFACES["dexgen"].files)
        super().__init__(hand, controller)
        if prior is None:
            assert isinstance(controller, Path)
            prior = _loaded_prior(controller.resolve(), file_stamps(controller))
        self.prior = prior.eval()
        self._guidance, self._steps = guidance, steps
        self._use_touch, self._use_splitter = use_touch, use_splitter
        shape = (1, 1, hand.n_fingers, self.controller.config.finger_chunk_width)
        self._noise = torch.randn(shape, generator=torch.Generator().manual_seed(seed))
        self._finger_of_joint = torch.tensor(hand.finger_of_joint)

    def _move(self, device: torch.device) -> None:
        super()._move(device)
        self.prior.to(device)

    @torch.no_grad()
    def step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        """Return the joint targets of the guided sample; see `Interface.step`."""
        with self.all_or_nothing(*self._parts):
            targets = self._step(observation, draft)
        return targets.to(observation[STATE].dtype if draft is None else draft.dtype)

    def _step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        sensed = self._sense(observation, draft)
        history = sensed.history if self._use_touch else sensed.history.without_touch()
        prior, scale = self.prior, self.controller.scale
        state = self.controller.encode(history)
        sensed = self._without_squeeze(sensed, history, state, self._use_splitter)
        wanted = scale.normalize(sensed.draft.draft.float())
        noise = self._noise.to(wanted).expand(len(wanted), -1, -1, -1)
        drawn = prior.sample(noise, wanted, self._guidance, self._steps, prior.context(state))[:, 0]
        motion = check_output("prior of DexGen", scale.restore(drawn))[:, 0].double()
        lead = check_output("inverse dynamics of DexGen", prior.lead(state, self.gain * drawn))
        lower, upper = (limit.to(motion) for limit in joint_limits(self.hand))
        joints = (sensed.measured.joints + lead.double()).clamp(lower, upper)
        free, asked = self._free(sensed, history), sensed.draft.draft[:, 0]
        motion = torch.where(free[..., None], asked, motion)
        followed = solve_fingertips(self.hand, sensed.measured.tips + self.gain * asked, self._hand.posture)
        joints = torch.where(free[:, self._finger_of_joint], followed, joints)
        self._motion = self.gain * motion
        self._explain(sensed, motion, free)
        return self._hand.execute(joints, joints)


@functools.cache
def _loaded_prior(folder: Path, stamps: tuple[tuple[str, int, int], ...]) -> DiffusionPrior:
    del stamps
    return DiffusionPrior.load(folder, ControllerConfig.load(folder / "config.json"))
