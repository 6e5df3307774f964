import math
from types import SimpleNamespace
from typing import cast

import pytest
import torch

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.training.corpus_data import CorpusData, tips_in_object
from lerobot_dexflex.training.fit import FitConfig
from lerobot_dexflex.training.world_model import WorldModelConfig, WorldModelStage, events, recorded


def turned(tips, angle):
    """Return where tips fixed to an object at (0.1, 0, 0) are once it turned about z; angle in degrees."""
    a, center = math.radians(angle), torch.tensor([0.1, 0.0, 0.0])
    rotation = torch.tensor([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0.0, 0, 1]])
    return center + (tips - center) @ rotation.mT


def test_a_tip_slips_if_it_moves_along_the_object_not_if_it_moves_with_it():
    """The object turns by 30 degrees and moves by 2 cm; its pose begins turned, so that order matters."""
    tips = torch.tensor([[0.1, 0.05, 0.0], [0.06, 0.0, 0.01], [0.1, -0.04, 0.0], [0.1, 0.0, 0.05]])
    shift = torch.tensor([0.0, 0.02, 0.0])
    course = torch.stack([turned(tips, 30 * k / 8) + k / 8 * shift for k in range(9)])
    course[8, 1] += torch.tensor([0.0, 0.0, 0.006])  # Along the object.
    course[8, 2] += torch.tensor([0.0, 0.0, 0.004])  # Rolls.
    course[:, 3] = tips[3] + torch.tensor([0.007, 0.0, 0.0])  # Stays where it is, the object passes it.
    poses = []
    for k in range(9):
        half = math.radians(70 + 30 * k / 8) / 2
        quaternion = torch.tensor([math.cos(half), 0.0, 0.0, math.sin(half)])
        poses.append(torch.cat([torch.tensor([0.1, 0.0, 0.0]) + k / 8 * shift, quaternion]))
    columns = {
        "in_object": tips_in_object(torch.stack(poses), course),
        "loads": torch.ones(9, 4),
        "lost": torch.zeros(9, dtype=torch.bool),
    }
    corpus, row = cast(CorpusData, SimpleNamespace(columns=columns)), torch.tensor([0])
    assert events(corpus, row).slip.tolist() == [[False, True, False, True]]
    columns["loads"][0, 1] = 0  # What does not touch now, or not at the end, does not slip.
    columns["loads"][8, 3] = 0
    found = events(corpus, row)
    assert not found.slip.any()
    assert found.contact_loss.tolist() == [[False, False, False, True]]


@pytest.fixture(scope="module")
def splits(corpus):
    return CorpusData(corpus, "train"), CorpusData(corpus, "tune")


def test_contact_is_lost_where_a_loaded_finger_ends_unloaded(splits):
    data = splits[0]
    rows, loads = data.transition_rows(), data.columns["loads"]
    found = recorded(data, rows).events
    ending = torch.stack([loads[rows + 7], loads[rows + 8]]).amin(0)
    assert torch.equal(found.contact_loss, (loads[rows] > 0.05) & (ending <= 0.05))
    assert found.contact_loss.any()
    lost = torch.stack([data.columns["lost"][rows + k] for k in range(8)]).any(0)
    assert torch.equal(found.grasp_loss, lost)


def test_the_stage_learns_a_batch_of_every_event_and_leaves_the_encoder(splits, learn):
    torch.manual_seed(0)
    controller = DexFlexController().eval().requires_grad_(False)
    before = {name: value.clone() for name, value in controller.state_dict().items()}
    stage = WorldModelStage(
        controller, splits[0], splits[1], WorldModelConfig(fit=FitConfig(batch_size=48), held_out_rows=64)
    )
    first, last = learn(stage)
    assert last < 0.8 * first
    changed = {name for name, value in controller.state_dict().items() if not value.equal(before[name])}
    assert {name.split(".")[0] for name in changed} == {"world_model"}
    with torch.no_grad():
        metrics = stage.evaluate()
    names = {f"{event}_auc{touch}" for event in ("contact_loss", "grasp_loss") for touch in ("", "_no_touch")}
    assert names | {"slip_share", "vs_copy"} <= set(metrics)
    assert 0 < metrics["slip_share"] < 1
