"""A released checkpoint: half the size, the same plans."""

import pytest
import torch
from safetensors.torch import load_file

from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy
from lerobot_policy_dexflex.release import WEIGHTS, main, release


@pytest.fixture
def trained(build, tmp_path):
    """A checkpoint whose running average differs from the trained weights."""
    policy = build()
    with torch.no_grad():
        for weight in policy.average.parameters():
            weight.add_(0.01)
    policy.save_pretrained(tmp_path / "trained")
    for name in ("policy_preprocessor.json", "policy_postprocessor.json"):
        (tmp_path / "trained" / name).write_text('{"name": "none", "steps": []}')
    return tmp_path / "trained"


def test_a_released_checkpoint_plans_alike_from_half_the_weights(trained, tmp_path, observation):
    release(trained, tmp_path / "released")

    whole, half = (
        DexflexFlowPolicy.from_pretrained(tmp_path / name).eval() for name in ("trained", "released")
    )
    plans = []
    for policy in (whole, half):
        torch.manual_seed(3)
        plans.append(policy.predict_action_chunk(dict(observation)))
    assert torch.equal(*plans)
    assert (tmp_path / "released" / WEIGHTS).stat().st_size < 0.55 * (trained / WEIGHTS).stat().st_size
    for average, begun in zip(half.average.parameters(), half.network.parameters(), strict=True):
        assert torch.equal(average, begun)
    assert {file.name for file in trained.iterdir()} == {f.name for f in (tmp_path / "released").iterdir()}


def test_a_released_checkpoint_may_not_lack_anything_else(trained, tmp_path):
    from safetensors.torch import save_file

    from lerobot_dexflex.errors import DexFlexError

    release(trained, tmp_path / "released")
    weights = load_file(tmp_path / "released" / WEIGHTS)
    del weights["average.norm.weight"]
    save_file(weights, tmp_path / "released" / WEIGHTS)
    with pytest.raises(DexFlexError, match=r"average\.norm\.weight"):
        DexflexFlowPolicy.from_pretrained(tmp_path / "released")


def test_what_cannot_be_released_is_refused_by_its_name(trained, backbone, tmp_path, capsys):
    released = tmp_path / "released"
    assert main([f"--policy={trained}", f"--output={released}"]) == 0
    for arguments, message in (
        ([f"--policy={trained}", f"--output={released}"], "holds a checkpoint already"),
        ([f"--policy={tmp_path / 'none'}", f"--output={tmp_path / 'x'}"], "lacks config.json"),
        ([f"--policy={backbone}", f"--output={tmp_path / 'x'}"], "holds no running average"),
    ):
        assert main(arguments) == 1
        assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
