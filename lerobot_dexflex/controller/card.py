"""The controller's model card, written from its configuration and training record alone."""

from collections.abc import Mapping
from typing import Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_dexflex.controller.config import ControllerConfig

_TEMPLATE = """\
---
{front_matter}
---

# DexFlex controller for the tactile hand `{hand}`

A draft-conditioned controller of [lerobot_dexflex](https://github.com/lerobot-dexflex/lerobot_dexflex):
upstream says where the fingertips should be, the controller supplies the grip. It encodes what the hand
feels, proposes chunks of fingertip motion from a few-step flow prior, predicts what each would lead to,
scores them against the draft, and decodes contact forces for the best.

| | |
|---|---|
| hand | `{hand}`, fingers {fingers}; {joints} joints |
| control rate | {rate:g} Hz, {horizon} steps per chunk |
| a draft's step | `{draft_definition}`: palm frame, metres, all fingertips |
| touch | {touch} |
| slow token | {slow} |

| part | parameters |
|---|---|
{parts}

## Use it

```python
from lerobot_dexflex.controller import DexFlexController

controller = DexFlexController.from_pretrained("path/or/hub-name")
```

At run time the `dexflex` interface feeds it observations and drafts, and realises the forces by leading the
joints. It refuses another hand, control rate or meaning of a draft.
{training}
## Known limitations

Trained in simulation only, on {count}. It corrects small errors of a command, it does not know the task.
"""


def controller_card(
    config: ControllerConfig, parts: Mapping[str, int], record: Mapping[str, Any]
) -> ModelCard:
    """Write the card.

    Args:
        config: The controller's configuration.
        parts: Number of parameters of each part.
        record: Sections of plain values: a mapping becomes a table, anything else a line.
    """
    layout, hands = config.layout, config.layout.hands
    rows, columns = layout.taxels
    data = ModelCardData(
        license="apache-2.0",
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=["dexterous", "tactile", "controller", "simulation"],
    )
    sizes = [f"| {name.replace('_', ' ')} | {count:,} |" for name, count in parts.items()]
    sizes.append(f"| together | {sum(parts.values()):,} |")
    return ModelCard(
        _TEMPLATE.format(
            front_matter=data.to_yaml().strip(),
            hand=config.hand,
            fingers="; ".join(", ".join(hand.finger_names) for hand in hands),
            joints=" and ".join(str(hand.n_joints) for hand in hands),
            count="one hand" if len(hands) == 1 else f"{len(hands)} hands",
            rate=config.rate,
            horizon=config.horizon,
            draft_definition=config.draft_definition,
            touch=f"{layout.n_fingers} x {rows} x {columns} taxels [N]" if config.use_touch else "not used",
            slow=f"{config.slow_levels} levels" if config.use_slow else "not used",
            parts="\n".join(sizes),
            training=_training(record),
        )
    )


def _training(record: Mapping[str, Any]) -> str:
    if not record:
        return ""
    lines = ["", "## Training and held-out results", ""]
    for section, values in record.items():
        title = section.replace("_", " ")
        if not isinstance(values, Mapping):
            lines += [f"{title}: `{values}`", ""]
            continue
        lines += [f"### {title}", "", "| | |", "|---|---|"]
        lines += [f"| {name.replace('_', ' ')} | {_number(value)} |" for name, value in values.items()]
        lines.append("")
    return "\n".join(lines) + "\n"


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else f"{value}"
