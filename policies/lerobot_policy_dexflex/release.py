"""Release a trained `dexflex_flow` checkpoint at half its size.

dexflex-release --policy=outputs/place_hammer/checkpoints/last/pretrained_model --output=outputs/released
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

from huggingface_hub.constants import SAFETENSORS_SINGLE_FILE as WEIGHTS

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.policy_files import check_policy_files


@dataclass
class Config:
    """Copy a checkpoint without the weights that only a resumed training needs."""

    policy: Path
    """Folder `pretrained_model` of a `dexflex_flow`."""
    output: Path
    """Folder of the copy; must not hold a checkpoint yet."""


def main(arguments: list[str] | None = None) -> int:
    """Run `dexflex-release`; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    release(config.policy, config.output)
    print(f"{config.output}: {(config.output / WEIGHTS).stat().st_size / 2**20:.1f} MiB of weights")
    return 0


def release(policy: Path, output: Path) -> None:
    """Copy a checkpoint; of the trained weights and their running average, only the average.

    The average acts in evaluation, and fine-tuning begins from it. `lerobot-train --resume=true` needs the
    checkpoint of the training itself.

    Args:
        policy: Folder `pretrained_model`.
        output: Folder of the copy.

    Raises:
        DexFlexError: If a file is missing or damaged, the checkpoint is none of `dexflex_flow`, or there is
            one in `output` already.
    """
    # Seconds of imports that --help need not pay.
    from safetensors.torch import load_file, save_file

    from lerobot_policy_dexflex.weights import AVERAGE, without_trained

    check_policy_files(policy)
    if (output / WEIGHTS).exists():
        raise DexFlexError(f"{output} holds a checkpoint already. Give another --output, or remove it first.")
    weights = load_file(policy / WEIGHTS)
    if not any(name.startswith(AVERAGE) for name in weights):
        raise DexFlexError(
            f"{policy / WEIGHTS} holds no running average: only checkpoints of dexflex_flow can be released."
        )
    output.mkdir(parents=True, exist_ok=True)
    for file in policy.iterdir():
        if file.is_file() and file.name != WEIGHTS:
            shutil.copyfile(file, output / file.name)
    # Written last: a folder with weights is whole.
    save_file(without_trained(weights), output / WEIGHTS, metadata={"format": "pt"})
