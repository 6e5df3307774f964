import dataclasses
import json

import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, SelectionSettings
from lerobot_dexflex.errors import DexFlexError

FEW = SelectionSettings(use_residual=True, n_pure=6, n_seeded=5)


def row(values, k):
    return type(values)(*[part[k : k + 1] for part in values])


def test_shapes_of_every_part(controller, history, draft):
    config = controller.config
    state = controller.encode(history)
    assert state.latent.shape == (3, config.latent_width)
    assert controller.encode_slow(history).shape == (3, config.slow_width)
    candidates = controller.propose(state, *draft, FEW)
    assert candidates.chunks.shape == (3, 12, 8, 4, 3)
    assert candidates.branch.tolist() == [0] + 6 * [1] + 5 * [2]
    assert torch.equal(candidates.chunks[:, 0], draft[0])
    dream = controller.dream(state, candidates)
    assert dream.latent.shape == (3, 12, config.latent_width)
    assert dream.contact_loss.shape == (3, 12, 4)
    assert dream.grasp_loss.shape == (3, 12)
    score = controller.score(state, draft[0], draft[1], candidates, dream.latent)
    assert score.shape == (3, 12)
    residual = controller.decode(state, candidates.chunks[:, 1], dream.latent[:, 1])
    assert residual.shape == (3, 16)
    assert residual.abs().max() <= config.residual_bound


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"temperature": 0.5},
        {"use_score": False},
        {"use_dream": False},
        {"n_pure": 0},
        {"n_seeded": 0},
        {"n_seeded": 0, "n_pure": 0},
        {"include_draft": False},
        {"nfe": 1},
        {"nfe": 3},
    ],
    ids=str,
)
def test_batched_decisions_equal_single_ones(controller, history, draft, changes):
    """Up to rounding: networks add up in another order in another batch."""
    settings = dataclasses.replace(FEW, **changes)
    together = controller.select(controller.encode(history), *draft, settings)
    assert together.chunk.shape == (3, 8, 4, 3)
    if together.score.shape[1] > 1:  # Scores differ by 1e-6 at most; no choice hangs on that.
        assert torch.diff(together.score.sort(1).values)[:, -1].min() > 1e-3
    for k in range(3):
        state = controller.encode(row(history, k))
        only = slice(k, k + 1)
        alone = controller.select(state, draft[0][only], draft[1][only], settings)
        assert torch.allclose(alone.score[0], together.score[k], atol=1e-4)
        assert torch.allclose(alone.chunk[0], together.chunk[k], atol=1e-7)
        assert torch.allclose(alone.residual[0], together.residual[k], atol=1e-6)


def test_same_seed_gives_the_same_candidates_and_another_seed_others(controller, history, draft):
    state = controller.encode(history)
    first, again, other = (
        controller.propose(state, *draft, dataclasses.replace(FEW, seed=seed)).chunks for seed in (0, 0, 1)
    )
    assert torch.equal(first, again)
    assert not torch.allclose(first[:, 1:], other[:, 1:])


def test_seeded_candidates_stay_nearer_to_the_draft_at_higher_levels(controller, history, draft):
    state = controller.encode(history)
    context = controller.prior.context(state)
    seed = controller.scale.normalize(draft[0]).unsqueeze(1)
    noise = torch.randn(3, 1, 96)
    starts = [(1 - t) * noise + t * seed for t in (0.5, 0.75)]
    distances = [float((start - seed).norm()) for start in starts]
    assert distances[1] < distances[0]
    assert controller.prior.sample(starts[1], [0.75], [1], context).shape == (3, 1, 96)


def test_without_a_score_the_proposal_nearest_to_the_draft_is_chosen(controller, history, draft):
    settings = dataclasses.replace(FEW, use_score=False)
    selection = controller.select(controller.encode(history), *draft, settings)
    error = (selection.candidates.chunks[:, 1:, :2] - draft[0][:, None, :2]).square().sum((2, 3, 4))
    assert torch.equal(selection.best, 1 + error.argmin(1))


def test_temperature_mixes_candidates(controller, history, draft):
    state = controller.encode(history)
    cold = controller.select(state, *draft, dataclasses.replace(FEW, temperature=1e-5))
    best = controller.select(state, *draft, FEW)
    assert torch.allclose(cold.chunk, best.chunk, atol=1e-7)
    hot = controller.select(state, *draft, dataclasses.replace(FEW, temperature=1e5))
    assert torch.allclose(hot.chunk, hot.candidates.chunks.mean(1), atol=1e-6)


def test_output_gain_scales_the_chunk(controller, history, draft):
    state = controller.encode(history)
    half = controller.select(state, *draft, dataclasses.replace(FEW, output_gain=0.5)).chunk
    assert torch.equal(2 * half, controller.select(state, *draft, FEW).chunk)


def test_hidden_touch_is_never_read(controller, history):
    hidden = history.without_touch()
    other = hidden._replace(tactile=hidden.tactile + 1, slow_loads=hidden.slow_loads + 1)
    assert torch.equal(controller.encode(hidden).features, controller.encode(other).features)
    assert not torch.equal(controller.encode(hidden).features, controller.encode(history).features)


def test_a_finger_without_touch_does_not_change_its_neighbours_tokens(controller, history):
    missing = history.tactile_missing.clone()
    missing[:, 1] = True
    tokens = controller.encode(history._replace(tactile_missing=missing)).fingers
    changed = (tokens != controller.encode(history).fingers).any(-1)
    assert changed.tolist() == [[False, True, False, False]] * 3


def test_controllers_without_touch_or_slow_token_never_read_them(history):
    blind = DexFlexController(ControllerConfig(use_touch=False, use_slow=False)).eval()
    other = history._replace(tactile=history.tactile + 1, slow_loads=history.slow_loads + 1)
    assert torch.equal(blind.encode(history).features, blind.encode(other).features)
    moved = history._replace(slow_fingertips=history.slow_fingertips.flip(1))
    assert torch.equal(blind.encode(history).slow, blind.encode(moved).slow)


def test_slow_token_takes_one_of_forty_values(controller):
    from lerobot_dexflex.controller.encoder import SlowToken

    generator = torch.Generator().manual_seed(0)
    rows = 600
    slow_history = controller_history(rows, generator)
    token = SlowToken(controller.config).eval()
    embedding, code = token(slow_history)
    assert code.min() >= 0
    assert code.max() < 40
    assert len(code.unique()) > 10
    assert len(embedding.round(decimals=4).unique(dim=0)) == len(code.unique())


def controller_history(rows, generator):
    from lerobot_dexflex.controller import History

    def noise(*shape):
        return torch.randn(rows, *shape, generator=generator)

    off = torch.zeros(rows, 4, dtype=torch.bool)
    tips = 0.08 + 0.004 * noise(8, 4, 3).cumsum(1)
    return History(
        noise(4, 16), tips[:, :4], noise(3), noise(4, 4, 10, 6), off, noise(8, 4).abs(), tips, off[:, 0]
    )


def test_cached_slow_token_is_used(controller, history):
    slow = torch.full((3, controller.config.slow_width), 0.5)
    assert torch.equal(controller.encode(history, slow).slow, slow)
    assert torch.equal(controller.encode(history).slow, controller.encode_slow(history))


def test_saving_and_loading_changes_nothing(controller, history, draft, tmp_path):
    controller.record = {"corpus": "somewhere", "score": {"given_top1": 0.5}}
    controller.save_pretrained(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {
        "config.json",
        "model.safetensors",
        "training.json",
        "README.md",
    }
    loaded = DexFlexController.from_pretrained(tmp_path)
    assert loaded.config == controller.config
    assert loaded.record == controller.record
    assert not loaded.training
    assert not any(p.requires_grad for p in loaded.parameters())
    before = controller.select(controller.encode(history), *draft, FEW)
    after = loaded.select(loaded.encode(history), draft[0], draft[1], FEW)
    assert torch.equal(before.chunk, after.chunk)
    assert torch.equal(before.residual, after.residual)
    card = (tmp_path / "README.md").read_text()
    assert "leap_right" in card
    assert "given top1" in card


def test_checkpoint_is_small(controller, tmp_path):
    sizes = controller.part_sizes()
    assert sum(sizes.values()) < 2_000_000
    controller.save_pretrained(tmp_path)
    assert (tmp_path / "model.safetensors").stat().st_size < 8e6


def test_missing_folders_and_files_are_refused(tmp_path):
    with pytest.raises(DexFlexError, match="dexflex-train"):
        DexFlexController.from_pretrained(tmp_path)
    with pytest.raises(DexFlexError, match="no such folder"):
        DexFlexController.from_pretrained(tmp_path / "nowhere")
    with pytest.raises(DexFlexError, match="nobody/nothing"):
        DexFlexController.from_pretrained("nobody/nothing", local_files_only=True)


def test_foreign_or_damaged_checkpoints_are_refused(controller, tmp_path):
    controller.save_pretrained(tmp_path)
    config = tmp_path / "config.json"
    values = json.loads(config.read_text())
    for change, message in (
        ({"embodiment": "allegro"}, "allegro"),
        ({"rate": 50.0}, "rate"),
        ({"prior_width": 48}, "does not hold the weights"),
    ):
        config.write_text(json.dumps(values | change))
        with pytest.raises(DexFlexError, match=message):
            DexFlexController.from_pretrained(tmp_path)
    config.write_text(json.dumps(values))
    weights = tmp_path / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])
    with pytest.raises(DexFlexError, match=r"model\.safetensors"):
        DexFlexController.from_pretrained(tmp_path)


def test_trained_decisions_follow_gradients(history, draft):
    """Every part that is trained by gradients gets them."""
    torch.manual_seed(0)
    controller = DexFlexController()
    torch.nn.init.normal_(controller.decoder.out.weight, std=0.1)
    state = controller.encode(history)
    dream = controller.dream(state, draft[0].unsqueeze(1))
    score = controller.score(state, draft[0], draft[1], draft[0].unsqueeze(1), dream.latent)
    residual = controller.decode(state, draft[0], dream.latent[:, 0])
    (score.sum() + residual.sum() + dream.grasp_loss.sum()).backward()
    for name in ("touch.out.weight", "body.0.weight", "key_value.weight", "slow.embed.0.weight"):
        gradient = controller.encoder.get_parameter(name).grad
        assert gradient is not None
        assert gradient.any(), name
