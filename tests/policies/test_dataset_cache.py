import logging

import pytest
import torch
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.transforms import ImageTransforms, ImageTransformsConfig

from lerobot_policy_dexflex import dataset_cache

WINDOW = {"action": [k / 20 for k in range(16)]}
HISTORY = WINDOW | {"observation.images.front": [-0.05, 0.0], "observation.state": [-0.1, 0.0]}


@pytest.fixture(autouse=True)
def lerobots_own_loader(monkeypatch):
    """Undo the replacement after each test."""
    monkeypatch.setattr(DatasetReader, "get_item", DatasetReader.get_item)
    monkeypatch.setattr(dataset_cache, "_limits", {})


def load(root, **settings):
    return LeRobotDataset("lerobot-dexflex/synthetic", root=root, video_backend="pyav", **settings)


def item(dataset, row) -> dict:
    return dataset[row]


def assert_equal_items(ours, theirs):
    assert list(ours) == list(theirs)
    for key, value in theirs.items():
        if isinstance(value, torch.Tensor):
            assert (ours[key].dtype, ours[key].shape) == (value.dtype, value.shape), key
            assert torch.equal(ours[key], value), key
        else:
            assert ours[key] == value, key


@pytest.mark.parametrize(
    "settings",
    [
        {"delta_timestamps": WINDOW, "return_uint8": True},
        {"delta_timestamps": HISTORY, "return_uint8": False},
        {"delta_timestamps": WINDOW, "return_uint8": True, "episodes": [0, 2]},
        {"image_transforms": lambda image: image.flip(-1), "return_uint8": True},
    ],
    ids=["windows", "history", "selected episodes", "transforms"],
)
def test_every_cached_item_equals_lerobots(synthetic_dataset, settings):
    dataset = load(synthetic_dataset, **settings)
    theirs = [dataset[row] for row in range(len(dataset))]
    dataset_cache.cache_dataset(dataset.meta, 1.0)
    for row, expected in enumerate(theirs):
        assert_equal_items(dataset[row], expected)
    assert isinstance(dataset_cache._caches[dataset.reader], dataset_cache.DatasetCache)


def test_random_image_transforms_are_drawn_for_every_item_as_lerobot_does(synthetic_dataset):
    transforms = ImageTransforms(ImageTransformsConfig(enable=True))
    dataset = load(synthetic_dataset, delta_timestamps=WINDOW, return_uint8=True, image_transforms=transforms)

    def draw(row, seed=0):
        torch.manual_seed(seed)
        return item(dataset, row)

    theirs = [draw(row) for row in range(len(dataset))]
    dataset_cache.cache_dataset(dataset.meta, 1.0)
    for row, expected in enumerate(theirs):
        assert_equal_items(draw(row), expected)
    assert isinstance(dataset_cache._caches[dataset.reader], dataset_cache.DatasetCache)
    front = "observation.images.front"
    assert not torch.equal(draw(3)[front], draw(3, seed=1)[front])


def test_worker_processes_leave_a_dataset_to_lerobot_with_a_warning(synthetic_dataset, caplog):
    dataset = load(synthetic_dataset)
    with caplog.at_level(logging.WARNING):
        dataset_cache.cache_dataset(dataset.meta, 1.0, workers=4)
    assert "not cached: 4 worker processes load it. Give --num_workers=0" in caplog.text
    assert "10-20 ms" in caplog.text
    dataset[0]
    assert dataset.reader not in dataset_cache._caches


def test_cached_items_are_copies(synthetic_dataset):
    dataset = load(synthetic_dataset, delta_timestamps=WINDOW, return_uint8=True)
    dataset_cache.cache_dataset(dataset.meta, 1.0)
    before = {key: value for key, value in item(dataset, 3).items() if isinstance(value, torch.Tensor)}
    before = {key: value.clone() for key, value in before.items()}
    for value in item(dataset, 3).values():
        if isinstance(value, torch.Tensor):
            value.zero_()
    assert all(torch.equal(item(dataset, 3)[key], value) for key, value in before.items())


def test_a_cached_video_is_not_decoded_again(synthetic_dataset, monkeypatch):
    dataset = load(synthetic_dataset, return_uint8=True)
    dataset_cache.cache_dataset(dataset.meta, 1.0)
    dataset[0]
    monkeypatch.setattr(DatasetReader, "_query_videos", None)
    assert item(dataset, 5)["observation.images.front"].shape == (3, 96, 96)


def test_a_dataset_beyond_the_memory_bound_is_left_to_lerobot_with_a_warning(synthetic_dataset, caplog):
    dataset = load(synthetic_dataset, return_uint8=True)
    theirs = dataset[7]
    # 60 frames: 2 cameras of 96 * 96 * 3 bytes, and about 300 numbers of at most 8 bytes, make 3.5 MB.
    dataset_cache.cache_dataset(dataset.meta, 0.003)
    with caplog.at_level(logging.WARNING):
        assert_equal_items(dataset[7], theirs)
    assert "the bound is 0.0 GB (--policy.cache_gigabytes)" in caplog.text
    assert dataset_cache._caches[dataset.reader] is None


def test_what_is_left_out_is_neither_kept_nor_decoded_nor_counted(synthetic_dataset, caplog):
    dataset = load(synthetic_dataset, delta_timestamps=HISTORY, return_uint8=True)
    theirs = item(dataset, 7)
    gone = {"observation.state", "observation.images.front"}
    # Only the wrist's camera is left: 60 frames of 96 * 96 * 3 bytes, and 300 numbers, make 1.8 MB.
    dataset_cache.cache_dataset(dataset.meta, 0.002, left_out=gone)
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        ours = item(dataset, 7)
    assert caplog.text == ""
    cache = dataset_cache._caches[dataset.reader]
    assert cache is not None
    assert not gone & {*cache._columns, *cache._frames}
    kept = {key: value for key, value in theirs.items() if key.removesuffix("_is_pad") not in gone}
    assert_equal_items(ours, kept)


def test_changed_internals_of_lerobot_leave_its_loader_in_charge(synthetic_dataset, caplog, monkeypatch):
    dataset = load(synthetic_dataset, delta_timestamps=WINDOW, return_uint8=True)
    theirs = dataset[7]
    monkeypatch.setattr(dataset_cache.DatasetCache, "_images", lambda *_: torch.zeros(3, 96, 96))
    dataset_cache.cache_dataset(dataset.meta, 1.0)
    with caplog.at_level(logging.WARNING):
        assert_equal_items(dataset[7], theirs)
    assert "differs from LeRobot's" in caplog.text


def test_other_datasets_are_not_touched(synthetic_dataset, tmp_path):
    meta = LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)
    meta.root = tmp_path
    dataset_cache.cache_dataset(meta, 1.0)
    dataset = load(synthetic_dataset)
    dataset[0]
    assert dataset.reader not in dataset_cache._caches
