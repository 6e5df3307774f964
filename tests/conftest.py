from collections.abc import Callable
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from lerobot_dexflex.hands import LEAP

SYNTHETIC_EPISODES = (20, 26, 14)


def make_synthetic_dataset(
    root: Path,
    cameras=("front", "wrist"),
    hand=LEAP,
    joints=None,
    size=96,
    offset=0.0,
    squeeze=0.0,
    rename=None,
    extra=None,
    **changes,
) -> Path:
    """Write a tiny dataset in our schema: a bright square in all images says where the hand shall go.

    Args:
        root: Folder to create.
        cameras: Names of the cameras.
        hand: The hand.
        joints: Names of the joints; all of hand and arm if None.
        size: Width and height of the images.
        offset: Added to joints and fingertips.
        squeeze: Added to commanded fingertips.
        rename: Other names of features, by name.
        extra: Sizes of further columns, by name.
        **changes: Overrides of `LeRobotDataset.create`, e.g. another `fps`.
    """
    import av.logging
    from lerobot.configs.video import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_dexflex.hand.model import robot_joints
    from lerobot_dexflex.recording.schema import columns, lerobot_features, robot_type

    av.logging.set_level(av.logging.PANIC)
    joints, rename, extra = joints or robot_joints(hand), rename or {}, extra or {}
    images = {f"observation.images.{camera}": (size, size, 3) for camera in cameras}
    features = lerobot_features(columns(hand, joints), images)
    features |= {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in extra.items()}
    arguments = {
        "repo_id": "lerobot-dexflex/synthetic",
        "fps": 20,
        "features": {rename.get(key, key): feature for key, feature in features.items()},
        "root": root,
        "robot_type": robot_type(hand, joints),
        "rgb_encoder": RGBEncoderConfig(vcodec="h264", g=2, crf=18),
        "streaming_encoding": True,
        "encoder_queue_maxsize": 1000,
        "video_backend": "pyav",
    }
    dataset = LeRobotDataset.create(**(arguments | changes))
    rng = np.random.default_rng(0)
    for steps in SYNTHETIC_EPISODES:
        goal = rng.uniform(-1, 1, 2)
        for k in range(steps):
            frame = _synthetic_frame(rng, goal, k / steps, images, hand, len(joints), offset, squeeze)
            frame |= {key: np.full(n, k, np.float32) for key, n in extra.items()}
            frame = {rename.get(key, key): value for key, value in frame.items()}
            kept = {key: value for key, value in frame.items() if key in dataset.features}
            dataset.add_frame(kept | {"task": "follow"})
        dataset.save_episode()
    dataset.finalize()
    return root


def _synthetic_frame(rng, goal, phase, images, hand, n_joints, offset, squeeze):
    size = next(iter(images.values()))[0]
    image = np.full((size, size, 3), 40, np.uint8)
    row, column = (size / 2 + 3 / 8 * size * goal).astype(int)
    image[row - 6 : row + 6, column - 6 : column + 6] = (230, 120, int(250 * phase))
    joints = offset + 0.3 + 0.3 * phase * np.resize(goal, n_joints)
    tips = offset + 0.05 + 0.02 * phase * np.resize(goal, 3 * hand.n_fingers)
    vectors = {
        "observation.state": joints + 0.01 * rng.standard_normal(n_joints),
        "observation.tactile": rng.exponential(0.05, hand.n_fingers * np.prod(hand.taxels)),
        "observation.fingertips": tips,
        "observation.gravity": np.array([0.0, 0.0, -1.0]),
        "action": np.concatenate([joints, tips + squeeze]),
    }
    views = {key: image[:: (-1) ** k].copy() for k, key in enumerate(images)}
    return views | {key: value.astype(np.float32) for key, value in vectors.items()}


def pytest_collection_modifyitems(items):
    """The longest first, so that no process is left alone with one at the end."""
    items.sort(key=lambda item: "test_readme" not in item.nodeid)


@pytest.fixture(scope="session")
def load_script() -> Callable[[str], ModuleType]:
    """Returns a script of `eval/`, by its name, as a module."""

    def load(name: str) -> ModuleType:
        spec = spec_from_file_location(name, Path(__file__).parents[1] / f"eval/{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def make_dataset() -> Callable[..., Path]:
    """Returns the function that writes a synthetic dataset."""
    return make_synthetic_dataset


@pytest.fixture(scope="session")
def synthetic_dataset(tmp_path_factory) -> Path:
    return make_synthetic_dataset(tmp_path_factory.mktemp("datasets") / "synthetic")


@pytest.fixture(scope="session")
def controller():
    """LEAP's of `controller_of`."""
    return random_controller(LEAP.name)


@pytest.fixture(scope="session")
def controller_of():
    """Returns the controller of a hand, by its name, that has random weights, also where it would start at
    zero; but it takes drafts for motion."""
    return random_controller


@cache
def random_controller(hand):
    import torch

    from lerobot_dexflex.controller import ControllerConfig, DexFlexController

    torch.manual_seed(0)
    controller = DexFlexController(ControllerConfig(hand=hand))
    with torch.no_grad():
        for value in controller.parameters():
            value.add_(0.02 * torch.randn_like(value))
        for value in controller.splitter.out.parameters():
            value.zero_()
    return controller.eval().requires_grad_(False)


@pytest.fixture(scope="session")
def controller_folder(tmp_path_factory):
    """The folder of the random controller, with random weights of DexGen."""
    from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior

    controller, folder = random_controller(LEAP.name), tmp_path_factory.mktemp("controller")
    controller.save_pretrained(folder)
    prior = DiffusionPrior(controller.config)
    prior.network.load_state_dict(controller.prior.state_dict())
    prior.save(folder)
    return folder


@pytest.fixture(scope="session")
def make_policy_checkpoint(tmp_path_factory) -> Callable[..., Path]:
    """Returns a function that saves a policy of random weights as lerobot-train does."""
    import torch
    from lerobot.configs import FeatureType
    from lerobot.envs.utils import env_to_policy_features
    from lerobot.policies.factory import make_pre_post_processors

    from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig
    from lerobot_policy_dexflex.configuration_env import DexflexEnvConfig
    from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy

    def make(**settings) -> Path:
        torch.manual_seed(0)
        features = env_to_policy_features(DexflexEnvConfig())
        statistics = {"mean": 0.0, "std": 0.3, "min": -0.5, "max": 0.5}
        sizes = {"action": 35, "observation.state": 23, "observation.fingertips": 12}
        stats = {key: {s: torch.full((n,), v) for s, v in statistics.items()} for key, n in sizes.items()}
        config = DexflexFlowConfig(interface="raw", device="cpu", dim=32, n_layers=1, **settings)
        config.input_features = {k: f for k, f in features.items() if f.type is not FeatureType.ACTION}
        config.output_features = {k: f for k, f in features.items() if f.type is FeatureType.ACTION}
        policy = DexflexFlowPolicy(config, dataset_stats=stats)
        # Plans that a hand can follow: 30 mrad and 2 mm around where it is.
        policy.scale.variance.copy_(torch.where(policy.plan.angles(), 0.03, 0.002).square())
        # Its output layer starts at zero: every untrained plan would be the mean, whatever the noise.
        torch.nn.init.normal_(policy.average.action_out.weight, std=0.3)
        folder = tmp_path_factory.mktemp("checkpoint")
        policy.save_pretrained(folder)
        for processor in make_pre_post_processors(config, dataset_stats=stats):
            processor.save_pretrained(folder)
        return folder

    return make


@pytest.fixture(scope="session")
def policy_checkpoint(make_policy_checkpoint) -> Path:
    """The folder of a policy of random weights that learned all parts of a plan."""
    return make_policy_checkpoint()
