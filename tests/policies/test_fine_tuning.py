"""A training from a checkpoint: what starts afresh, what goes on, and which datasets fit."""

import json

import pytest
import torch
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot_commands import begin_training

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy

NETWORK = ["--policy.dim=32", "--policy.n_layers=1", "--policy.n_heads=2", "--policy.n_keypoints=8"]
LOCAL = ["--policy.device=cpu", "--policy.push_to_hub=false"]


@pytest.fixture(scope="module")
def datasets(make_dataset, tmp_path_factory):
    """Datasets that differ from the synthetic one, by what differs."""
    folder = tmp_path_factory.mktemp("datasets")
    kinds = {
        "elsewhere": {"offset": 0.2},
        "other cameras": {"cameras": ("side", "top")},
        "one camera": {"cameras": ("front",)},
        "three cameras": {"cameras": ("front", "top", "wrist")},
        "large images": {"size": 128},
        "odd images": {"size": 100},
        "hand alone": {"joints": LEAP.joint_names, "robot_type": "leap"},
        "other names": {"rename": {"observation.tactile": "observation.touch"}},
        "other state": {"rename": {"observation.state": "observation.joints"}},
    }
    return {kind: make_dataset(folder / kind, **changes) for kind, changes in kinds.items()}


@pytest.fixture(scope="module")
def checkpoint(synthetic_dataset, tmp_path_factory):
    """A checkpoint that looks like one after 5000 steps, with what a resumption needs."""
    with pytest.MonkeyPatch.context() as patch:
        run = begin_training(
            patch, "--policy.type=dexflex_flow", *NETWORK, *LOCAL, f"--dataset.root={synthetic_dataset}"
        )
    run.policy.updates.fill_(5000)
    folder = tmp_path_factory.mktemp("run") / "checkpoints/005000/pretrained_model"
    run.policy.save_pretrained(folder)
    for processor in run.processors:
        processor.save_pretrained(folder)
    run.config.save_pretrained(folder)
    return folder


@pytest.fixture
def fine_tune(checkpoint, datasets, monkeypatch):
    def begin(kind, *arguments):
        return begin_training(
            monkeypatch,
            f"--policy.path={checkpoint}",
            "--policy.push_to_hub=false",
            f"--dataset.root={datasets[kind]}",
            *arguments,
        ).policy

    return begin


def test_fine_tuning_keeps_the_weights_and_starts_statistics_and_average_afresh(
    fine_tune, checkpoint, datasets, monkeypatch
):
    tuned = fine_tune("elsewhere")
    scratch = begin_training(
        monkeypatch, "--policy.type=dexflex_flow", *NETWORK, *LOCAL, f"--dataset.root={datasets['elsewhere']}"
    ).policy
    for name, value in scratch.normalization.state_dict().items():
        assert torch.equal(tuned.normalization.state_dict()[name], value), name
    saved = type(tuned).from_pretrained(checkpoint)
    assert all(map(torch.equal, tuned.network.parameters(), saved.network.parameters()))
    assert (tuned.updates.item(), saved.updates.item()) == (0, 5000)
    # 0.2 rad are between the two datasets, so that old statistics would show.
    moved = tuned.normalization.state.mean - saved.normalization.state.mean
    torch.testing.assert_close(moved, torch.full((23,), 0.2), rtol=0, atol=0.02)


def test_after_a_few_steps_of_fine_tuning_the_average_is_the_new_policy(fine_tune):
    tuned = fine_tune("elsewhere")
    with torch.no_grad():
        for value in tuned.network.parameters():
            value.add_(1.0)
    for _ in range(10):
        tuned.update()
    gap = torch.stack(
        [
            (a - b).abs().max()
            for a, b in zip(tuned.average.parameters(), tuned.network.parameters(), strict=True)
        ]
    )
    assert gap.max() < 1e-4  # With the old counter 99 % of the change would be missing.


@pytest.mark.parametrize("told_by", ["command line", "file"])
def test_a_resumption_keeps_statistics_and_average(checkpoint, datasets, monkeypatch, told_by, tmp_path):
    file = checkpoint / "train_config.json"
    resume = ["--resume=true"]
    if told_by == "file":  # The configuration of a run that was itself resumed says so.
        for path in checkpoint.iterdir():
            (tmp_path / path.name).write_bytes(path.read_bytes())
        file, resume = tmp_path / "train_config.json", []
        file.write_text(json.dumps(json.loads(file.read_text()) | {"resume": True}))
    run = begin_training(
        monkeypatch, f"--config_path={file}", *resume, f"--dataset.root={datasets['elsewhere']}"
    )
    saved = type(run.policy).from_pretrained(checkpoint)
    assert run.policy.updates.item() == 5000
    assert torch.equal(run.policy.normalization.state.mean, saved.normalization.state.mean)


def test_a_program_that_trains_from_a_checkpoint_starts_afresh_too(checkpoint, datasets):
    from lerobot.configs import PreTrainedConfig

    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.pretrained_path = checkpoint
    meta = LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=datasets["elsewhere"])
    policy = make_policy(config, ds_meta=meta)
    assert isinstance(policy, DexflexFlowPolicy)
    assert policy.updates.item() == 0
    assert meta.stats is not None
    mean = torch.as_tensor(meta.stats["observation.state"]["mean"], dtype=torch.float32)
    assert torch.equal(policy.normalization.state.mean, mean)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("other cameras", r"reads observation.images.front, observation.images.wrist, which the dataset does "
         r"not.*--rename_map='\{\"observation.images.side\": \"observation.images.front\", "
         r"\"observation.images.top\": \"observation.images.wrist\"\}', or train a new policy"),
        ("one camera", r"images.wrist, which the dataset does not offer.*Train a new policy"),
        ("large images", r"front of shape \(3, 96, 96\), but the dataset offers shape \(3, 128, 128\)"),
        ("hand alone", r"observation.state of shape \(23,\), but the dataset offers shape \(16,\)"),
        ("other names", r"lacks 'observation.tactile'.*It has: .*observation.touch"),
    ],
)  # fmt: skip
def test_a_dataset_that_a_checkpoint_cannot_learn_from_is_refused_when_it_is_loaded(fine_tune, kind, message):
    with pytest.raises(DexFlexError, match=message):
        fine_tune(kind)


def test_a_camera_that_the_checkpoint_does_not_know_is_left_out(fine_tune):
    assert list(fine_tune("three cameras").config.image_features) == [
        "observation.images.front",
        "observation.images.wrist",
    ]


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("other cameras", {"top": "front", "side": "wrist"}),
        ("other names", {"observation.touch": "observation.tactile"}),
        ("other state", {"observation.joints": "observation.state"}),
    ],
)
def test_a_rename_map_fits_a_dataset_to_a_checkpoint(checkpoint, datasets, monkeypatch, kind, names):
    if kind == "other cameras":
        names = {f"observation.images.{old}": f"observation.images.{new}" for old, new in names.items()}
    run = begin_training(
        monkeypatch,
        f"--policy.path={checkpoint}",
        "--policy.push_to_hub=false",
        f"--dataset.root={datasets[kind]}",
        f"--rename_map={json.dumps(names)}",
    )
    raw = torch.utils.data.default_collate([run.train_set[row] for row in (0, 30)])
    for key in run.train_set.meta.camera_keys:
        raw[key] = raw[key].float() / 255  # As lerobot-train does.
    loss, _ = run.policy.train().forward(run.processors[0](raw))
    loss.backward()
    assert torch.isfinite(loss)


def test_columns_that_the_policy_does_not_read_stay_out_of_its_way(
    make_dataset, monkeypatch, tmp_path, caplog
):
    extra = {"operator.draft": 96, "contact.loads": 12}
    root = make_dataset(tmp_path / "extra", extra=extra)
    run = begin_training(
        monkeypatch, "--policy.type=dexflex_flow", *NETWORK, *LOCAL, f"--dataset.root={root}"
    )
    item = run.train_set[3]
    assert not set(extra) & set(item)
    assert "is not cached" not in caplog.text
    assert not set(extra) & set(run.policy.config.input_features)
    uncached = begin_training(
        monkeypatch,
        "--policy.type=dexflex_flow",
        "--policy.cache_dataset=false",
        *NETWORK,
        *LOCAL,
        f"--dataset.root={root}",
    )
    for each in (run, uncached):
        raw = torch.utils.data.default_collate([each.train_set[row] for row in (0, 30)])
        for key in each.train_set.meta.camera_keys:
            raw[key] = raw[key].float() / 255
        assert torch.isfinite(each.policy.train().forward(each.processors[0](raw))[0])


@pytest.mark.parametrize("kind", ["other cameras", "one camera", "large images", "hand alone"])
def test_a_new_policy_takes_the_cameras_and_joints_of_its_dataset(datasets, monkeypatch, kind):
    robot = ["--policy.interface=raw"]
    run = begin_training(
        monkeypatch,
        "--policy.type=dexflex_flow",
        *NETWORK,
        *LOCAL,
        *robot,
        f"--dataset.root={datasets[kind]}",
    )
    cameras = run.train_set.meta.camera_keys
    assert list(run.policy.config.image_features) == cameras
    raw = torch.utils.data.default_collate([run.train_set[row] for row in (0, 30)])
    for key in cameras:
        raw[key] = raw[key].float() / 255
    assert torch.isfinite(run.policy.train().forward(raw)[0])


def test_a_new_policy_refuses_images_that_its_network_cannot_halve(datasets, monkeypatch):
    with pytest.raises(DexFlexError, match=r"multiples of 8. Got observation.images.front of 3 .* 100 x 100"):
        begin_training(
            monkeypatch, "--policy.type=dexflex_flow", *LOCAL, f"--dataset.root={datasets['odd images']}"
        )


def test_a_new_training_without_touch_does_not_recommend_a_rename_map(datasets, monkeypatch):
    with pytest.raises(DexFlexError, match=r"Missing: observation\.tactile") as error:
        begin_training(
            monkeypatch, "--policy.type=dexflex_flow", *LOCAL, f"--dataset.root={datasets['other names']}"
        )
    assert "rename_map" not in str(error.value)


def test_a_training_whose_evaluation_would_fail_is_refused_at_its_beginning(
    synthetic_dataset, datasets, monkeypatch
):
    def begin(root, *arguments):
        begin_training(
            monkeypatch, "--policy.type=dexflex_flow", *NETWORK, *LOCAL, f"--dataset.root={root}", *arguments
        )

    reach = ["--env.type=dexflex", "--env.task=Reach-v0"]
    with pytest.raises(DexFlexError, match=r"state of shape \(23,\), but the environment Reach-v0 offers"):
        begin(synthetic_dataset, *reach)
    with pytest.raises(DexFlexError, match=r"wrist, which the environment PlaceHammer-v0 does not offer"):
        begin(synthetic_dataset, "--env.type=dexflex", "--env.options={'cameras': ['front']}")
    with pytest.raises(DexFlexError, match=r"Its cameras side, top are none of ours \(front, wrist\)"):
        begin(datasets["other cameras"], "--env.type=dexflex")
    begin(synthetic_dataset, *reach, "--env_eval_freq=0")
    begin(synthetic_dataset, "--env.type=dexflex")
