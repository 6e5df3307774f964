import copy
import dataclasses
import json

import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, SelectionSettings
from lerobot_dexflex.controller.chunks import BRANCHES, DRAFT, FINGER, SEEDED
from lerobot_dexflex.errors import DexFlexError

FEW = SelectionSettings(n_pure=6, n_seeded=5, n_finger=8, include_draft=True, hysteresis=0.0)


def row(values, k):
    return type(values)(*[part[k : k + 1] for part in values])


def test_shapes_of_every_part(hand, controller, history, draft):
    config, n = controller.config, hand.n_fingers
    state = controller.encode(history)
    assert state.latent.shape == (3, config.latent_width)
    assert controller.encode_slow(history).shape == (3, config.slow_width)
    candidates = controller.propose(state, draft[0], FEW)
    assert candidates.chunks.shape == (3, FEW.n_candidates, 8, n, 3)
    assert [BRANCHES[k] for k in candidates.branch] == ["draft"] + 6 * ["pure"] + 5 * ["seeded"] + 8 * [
        "finger"
    ]
    dream = controller.dream(state, candidates)
    assert dream.latent.shape == (3, 20, config.latent_width)
    assert dream.contact_loss.shape == dream.slip.shape == (3, 20, n)
    assert dream.grasp_loss.shape == (3, 20)
    score = controller.score(state, draft[0], draft[1], candidates, dream.latent)
    assert score.shape == (3, 20)
    forces = controller.decode(state, candidates.chunks[:, 1])
    assert forces.vector.shape == (3, n, 3)
    assert forces.pressing.shape == (3, n)


def test_the_first_candidate_is_the_draft_and_of_finger_candidates_one_finger_is_drawn(
    hand, controller, history, draft
):
    n = hand.n_fingers
    settings = dataclasses.replace(FEW, n_finger=2 * n, finger_levels=(0.0, 0.5), others_level=1.0)
    candidates = controller.propose(controller.encode(history), draft[0], settings)
    assert torch.equal(candidates.chunks[:, 0], draft[0])
    alone = candidates.chunks[:, candidates.branch == FINGER]
    moved = (alone - draft[0].unsqueeze(1)).abs().amax((2, 4))  # (batch, candidates, fingers)
    drawn = torch.eye(n, dtype=torch.bool).repeat(2, 1).expand(3, -1, -1)
    assert moved[~drawn].max() < 1e-8
    assert moved[drawn].min() > 1e-5


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"use_score": False},
        {"use_dream": False},
        {"n_pure": 0},
        {"n_seeded": 0},
        {"n_finger": 0},
        {"n_seeded": 0, "n_pure": 0, "n_finger": 0},
        {"hysteresis": 1.0},
        {"include_draft": False},
        {"nfe": 1},
        {"nfe": 3},
    ],
    ids=str,
)
def test_batched_decisions_equal_single_ones(controller, history, draft, changes):
    """Up to rounding: networks add up in another order in another batch."""
    settings = dataclasses.replace(FEW, **changes)
    whole = controller.encode(history)
    together = controller.select(whole, *draft, settings)
    assert together.chunk.shape == draft[0].shape
    if together.score.shape[1] > 1:  # Scores differ by 1e-6 at most; no choice hangs on that.
        assert torch.diff(together.score.sort(1).values)[:, -1].min() > 1e-3
    for k in range(3):
        state = controller.encode(row(history, k))
        only = slice(k, k + 1)
        alone = controller.select(state, draft[0][only], draft[1][only], settings)
        assert torch.allclose(alone.score[0], together.score[k], atol=1e-4)
        assert torch.allclose(alone.chunk[0], together.chunk[k], atol=1e-7)
        forces, others = controller.decode(state, alone.chunk), controller.decode(whole, together.chunk)
        assert torch.allclose(forces.vector[0], others.vector[k], atol=1e-4)


def test_same_seed_gives_the_same_candidates_and_another_seed_others(controller, history, draft):
    state = controller.encode(history)
    first, again, other = (
        controller.propose(state, draft[0], dataclasses.replace(FEW, seed=seed)).chunks for seed in (0, 0, 1)
    )
    assert torch.equal(first, again)
    assert not torch.allclose(first[:, 1:], other[:, 1:])


def test_candidates_start_between_noise_and_the_draft_as_their_level_says(
    hand, controller, history, draft, monkeypatch
):
    """With a sampler that does nothing candidates are what it would start from."""
    n = hand.n_fingers
    monkeypatch.setattr(controller.prior, "sample", lambda x, start, steps, context: x)
    settings = SelectionSettings(
        n_pure=1, n_seeded=2, n_finger=2 * n, levels=(0.5, 0.75), finger_levels=(0, 0.25), others_level=0.9
    )
    noise = torch.randn(3, 3 + 2 * n, n, 24, generator=torch.Generator().manual_seed(3))
    chunks = controller.propose(controller.encode(history), draft[0], settings, noise).chunks
    level = torch.tensor([[0.0] * n, [0.5] * n, [0.75] * n])
    level = torch.cat([level, 0.9 * (1 - torch.eye(n)), 0.9 - 0.65 * torch.eye(n)])[:, None, :, None]
    expected = (1 - level) * controller.scale.restore(noise) + level * draft[0].unsqueeze(1)
    torch.testing.assert_close(chunks, expected, rtol=0, atol=1e-7)


def test_without_a_score_the_proposal_nearest_to_the_draft_is_chosen(controller, history, draft):
    settings = dataclasses.replace(FEW, use_score=False)
    selection = controller.select(controller.encode(history), *draft, settings)
    error = (selection.candidates.chunks[:, 1:, :2] - draft[0][:, None, :2]).square().sum((2, 3, 4))
    assert torch.equal(selection.best, 1 + error.argmin(1))


def test_hysteresis_favours_those_that_follow_the_draft_with_the_whole_hand(controller, history, draft):
    state = controller.encode(history)
    free = controller.select(state, *draft, FEW)
    follows = (free.candidates.branch == DRAFT) | (free.candidates.branch == SEEDED)
    assert not follows[free.best].all()
    behind = free.score.amax(1) - free.score[:, follows].amax(1)
    for hysteresis, obeyed in ((float(behind.max()) * 1.01, True), (float(behind.max()) * 0.99, False)):
        best = controller.select(state, *draft, dataclasses.replace(FEW, hysteresis=hysteresis)).best
        assert bool(follows[best].all()) == obeyed


@pytest.mark.parametrize(
    ("weight", "part"),
    [
        ("encoder.body.0.weight", "encoder"),
        ("encoder.slow.embed.0.weight", "encoder"),
        ("prior.chunk_out.weight", "prior"),
        ("world_model.out.weight", "world model"),
        ("ranker.out.weight", "score"),
        ("decoder.out.weight", "decoder"),
    ],
)
def test_no_part_passes_on_what_is_no_number(controller, history, draft, weight, part):
    broken = copy.deepcopy(controller)
    broken.get_parameter(weight).view(-1)[0] = torch.nan

    def decide():
        state = broken.encode(history)
        broken.decode(state, broken.select(state, *draft, FEW).chunk)

    with pytest.raises(DexFlexError, match=f"'s {part} put out NaN or infinity; nothing was executed"):
        decide()


def test_a_draft_that_is_no_number_is_noticed_even_where_it_is_the_only_candidate(controller, history, draft):
    only = SelectionSettings(n_pure=0, n_seeded=0, n_finger=0, include_draft=True)
    with pytest.raises(DexFlexError, match="NaN"):
        controller.select(controller.encode(history), torch.full_like(draft[0], torch.nan), draft[1], only)


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
    assert changed.tolist() == [[k == 1 for k in range(changed.shape[1])]] * 3


def test_controllers_without_touch_or_slow_token_never_read_them(hand, history):
    blind = DexFlexController(ControllerConfig(hand=hand.name, use_touch=False, use_slow=False)).eval()
    other = history._replace(tactile=history.tactile + 1, slow_loads=history.slow_loads + 1)
    assert torch.equal(blind.encode(history).features, blind.encode(other).features)
    moved = history._replace(slow_fingertips=history.slow_fingertips.flip(1))
    assert torch.equal(blind.encode(history).slow, blind.encode(moved).slow)


def test_slow_token_takes_one_of_forty_values(hand, controller):
    from lerobot_dexflex.controller.encoder import SlowToken

    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    rows = 600
    slow_history = controller_history(hand, rows, generator)
    token = SlowToken(controller.config).eval()
    embedding, code = token(slow_history)
    assert code.min() >= 0
    assert code.max() < 40
    assert len(code.unique()) > 5
    assert len(embedding.round(decimals=4).unique(dim=0)) == len(code.unique())


def controller_history(hand, rows, generator):
    from lerobot_dexflex.controller import History

    def noise(*shape):
        return torch.randn(rows, *shape, generator=generator)

    n = hand.n_fingers
    turns, geometry = torch.eye(3).expand(rows, n, 3, 3), torch.zeros(rows, n, 0)
    off = torch.zeros(rows, n, dtype=torch.bool)
    tips = 0.08 + 0.004 * noise(8, n, 3).cumsum(1)
    joints, touch = noise(4, hand.n_joints), noise(4, n, *hand.taxels)
    seen = joints, tips[:, :4], noise(3), touch, off, noise(8, n).abs(), tips, off[:, 0]
    return History(*seen, turns, geometry)


def test_every_joint_reaches_the_token_of_its_finger_and_no_other(hand, controller, history):
    """Also where fingers have different numbers of joints; fingertips and gravity stay as they are."""
    frame, before = torch.zeros(3, hand.n_joints), controller.encode(history).fingers
    for joint, finger in enumerate(hand.finger_of_joint):
        past = frame.clone()
        past[:, joint] = 0.01
        joints = torch.cat([history.joints[:, :1], history.joints[:, 1:] + past[:, None]], 1)
        changed = (controller.encode(history._replace(joints=joints)).fingers != before).any(-1)
        assert changed.tolist() == [[k == finger for k in range(hand.n_fingers)]] * 3


def test_cached_slow_token_is_used(controller, history):
    slow = torch.full((3, controller.config.slow_width), 0.5)
    assert torch.equal(controller.encode(history, slow).slow, slow)
    assert torch.equal(controller.encode(history).slow, controller.encode_slow(history))


def test_saving_and_loading_changes_nothing(hand, controller, history, draft, tmp_path):
    controller.record = {"corpus": "somewhere", "score": {"spoilt_picked_mm": 0.5}}
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
    forces = [each.decode(each.encode(history), before.chunk).vector for each in (controller, loaded)]
    assert torch.equal(*forces)
    card = (tmp_path / "README.md").read_text()
    assert f"`{hand.name}`, fingers {', '.join(hand.finger_names)}; {hand.n_joints} joints" in card
    assert "spoilt picked mm" in card


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
        ({"hand": "allegro"}, "There is no hand 'allegro'"),
        ({"hand": "sharpa" if controller.config.hand == "leap" else "leap"}, "does not hold the weights"),
        ({"rate": 50.0}, "rate"),
        ({"draft_definition": "commanded_displacement"}, "Train it anew"),
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


def test_every_part_passes_gradients_on_to_the_encoder(hand, history, draft):
    torch.manual_seed(0)
    controller = DexFlexController(ControllerConfig(hand=hand.name))
    state = controller.encode(history)
    dream = controller.dream(state, draft[0].unsqueeze(1))
    score = controller.score(state, draft[0], draft[1], draft[0].unsqueeze(1), dream.latent)
    forces = controller.decode(state, draft[0])
    for output in (score, dream.grasp_loss, dream.slip, forces.vector, forces.pressing):
        controller.zero_grad()
        output.sum().backward(retain_graph=True)
        for name in ("touch.out.weight", "body.0.weight", "key_value.weight", "slow.embed.0.weight"):
            gradient = controller.encoder.get_parameter(name).grad
            assert gradient is not None
            assert gradient.any(), name
