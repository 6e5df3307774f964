"""The fingertips that a policy learns: where they were measured one step after the action."""

from typing import Any

import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_commands import begin_training

from lerobot_dexflex.errors import DexFlexError
from lerobot_policy_dexflex import dataset_cache, measured_tips
from lerobot_policy_dexflex.measured_tips import NEXT_TIPS, add_measured_tips

WINDOW = {"action": [k / 20 for k in range(16)]}
EPISODES = ((0, 20), (20, 46), (46, 60))
"""First row and end of the synthetic episodes."""


@pytest.fixture(autouse=True)
def lerobots_own_loader(monkeypatch):
    """Undo the replacements after each test."""
    monkeypatch.setattr(LeRobotDataset, "__getitem__", LeRobotDataset.__getitem__)
    monkeypatch.setattr(measured_tips, "_columns", {})
    monkeypatch.setattr(dataset_cache.DatasetReader, "get_item", dataset_cache.DatasetReader.get_item)
    monkeypatch.setattr(dataset_cache, "_limits", {})


def load(root, **settings) -> Any:
    return LeRobotDataset(
        "lerobot-dexflex/synthetic",
        root=root,
        video_backend="pyav",
        return_uint8=True,
        **{"delta_timestamps": WINDOW, **settings},
    )


def expected(dataset, row):
    """Measured fingertips of the 16 steps after a row's, read row by row; none from beyond the episode."""
    assert dataset.hf_dataset is not None
    end = next(end for first, end in EPISODES if first <= row < end)
    rows = [min(row + 1 + k, end - 1) for k in range(16)]
    return torch.stack([dataset.hf_dataset[r]["observation.fingertips"] for r in rows])


@pytest.mark.parametrize("cached", [False, True])
def test_every_action_gets_the_fingertips_of_the_next_step_and_the_last_its_own(synthetic_dataset, cached):
    dataset = load(synthetic_dataset)
    if cached:
        dataset_cache.cache_dataset(dataset.meta, 1.0)
    add_measured_tips(dataset.meta)
    for row in (0, 3, 18, 19, 20, 44, 45, 59):
        item = dataset[row]
        assert torch.equal(item[NEXT_TIPS], expected(dataset, row)), row
    assert (dataset.reader in dataset_cache._caches) == cached
    last = dataset[19]
    assert torch.equal(last[NEXT_TIPS], last["observation.fingertips"].expand(16, -1))


def test_the_rest_of_an_item_stays_lerobots(synthetic_dataset):
    dataset = load(synthetic_dataset)
    theirs = dataset[7]
    add_measured_tips(dataset.meta)
    ours = dataset[7]
    assert set(ours) - set(theirs) == {NEXT_TIPS}
    assert all(torch.equal(ours[key], value) for key, value in theirs.items() if torch.is_tensor(value))


def test_selected_episodes_slices_and_items_without_a_window(synthetic_dataset):
    whole, some = load(synthetic_dataset), load(synthetic_dataset, episodes=[1, 2])
    add_measured_tips(some.meta)
    assert torch.equal(some[25][NEXT_TIPS], expected(whole, 45))
    assert torch.equal(some[26][NEXT_TIPS], expected(whole, 46))
    sliced = some[24:27]
    assert [item[NEXT_TIPS].shape for item in sliced] == [(16, 12)] * 3
    single = load(synthetic_dataset, delta_timestamps=None)[30]
    assert torch.equal(single[NEXT_TIPS], expected(whole, 30)[0])


def test_other_datasets_are_not_touched(synthetic_dataset, make_dataset, tmp_path):
    add_measured_tips(load(synthetic_dataset).meta)
    assert NEXT_TIPS not in load(make_dataset(tmp_path / "other"))[0]


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_loader_processes_add_them_too(synthetic_dataset, context):
    dataset = load(synthetic_dataset)
    add_measured_tips(dataset.meta)
    loader = torch.utils.data.DataLoader(
        dataset, 3, sampler=[0, 19, 45], num_workers=1, multiprocessing_context=context
    )
    (batch,) = loader
    assert torch.equal(batch[NEXT_TIPS], torch.stack([expected(dataset, row) for row in (0, 19, 45)]))


def test_a_batch_without_them_is_refused_with_the_way_out():
    tips = torch.full((1, 2, 12), -1.0)
    assert measured_tips.measured_tips({NEXT_TIPS: tips}) is tips
    with pytest.raises(
        DexFlexError, match=r"lacks 'observation.next_fingertips'.*--policy.learns=\[joint,comm"
    ):
        measured_tips.measured_tips({"action": torch.zeros(1, 2, 35)})


@pytest.mark.parametrize("learns", ["joint", "commanded", "measured", "joint,commanded,measured"])
def test_a_policy_learns_the_parts_of_the_plan_that_it_is_told_to(
    make_dataset, monkeypatch, tmp_path, learns
):
    """Measured and commanded fingertips are 0.1 m apart here, so that one could not pass for the other."""
    root = make_dataset(tmp_path / "apart", squeeze=0.1)
    interface = "joint" if learns == "joint" else "raw"
    policy = ["--policy.type=dexflex_flow", f"--policy.interface={interface}", f"--policy.learns=[{learns}]"]
    network = ["--policy.dim=32", "--policy.n_layers=1", "--policy.n_heads=2", "--policy.n_keypoints=8"]
    local = ["--policy.device=cpu", "--policy.push_to_hub=false", f"--dataset.root={root}"]
    run = begin_training(monkeypatch, *policy, *network, *local)
    assert run.policy.config.learns == learns.split(",")
    batch = torch.utils.data.default_collate([run.train_set[row] for row in (0, 30)])
    assert (NEXT_TIPS in batch) == ("measured" in learns)
    for key in run.train_set.meta.camera_keys:
        batch[key] = batch[key].float() / 255  # As lerobot-train does.
    seen = {}
    monkeypatch.setattr(
        type(run.policy), "_draw", lambda self, x_1: seen.update(x_1=x_1) or _drawn(x_1, run.policy)
    )
    run.policy.train().forward(run.processors[0](batch))
    plan = run.policy.scale.inverse(seen["x_1"])
    wanted = {"joint": batch["action"][..., 7:23], "commanded": batch["action"][..., 23:]}
    wanted["measured"] = batch.get(NEXT_TIPS)
    for part in learns.split(","):
        found = plan[..., run.policy.plan.columns(part)]
        whole = torch.cat([batch["action"][..., :7], wanted[part]], -1)
        torch.testing.assert_close(found, whole, rtol=0, atol=1e-5)
    assert (batch["action"][..., 23:] - batch["observation.fingertips"][:, None]).min() > 0.05


def _drawn(x_1, policy):
    draws = policy.config.noise_draws
    return torch.full((draws, len(x_1)), 0.5), torch.zeros(draws, *x_1.shape)
