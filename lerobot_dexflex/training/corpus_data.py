"""A split of the reach corpus in memory, and batches gathered from it."""

from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from lerobot_dexflex.controller.config import DRAFT_HISTORY, FRAMES
from lerobot_dexflex.controller.history import SLOW_OFFSETS, History, past_rows
from lerobot_dexflex.controller.layout import Layout, SharedLayout, layout_of
from lerobot_dexflex.controller.view import view_of
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.corpus.schema import columns
from lerobot_dexflex.corpus.shard import read_header
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import contact_torques, finger_frames, fingertips, leads, pads
from lerobot_dexflex.hands import Hand, get_hand
from lerobot_dexflex.runs.provenance import digest_text

SPLITS = ("train", "tune")
"""Splits that training may read; test objects are kept for the benchmark."""


class CorpusData:
    """All rows of a split as tensors; touch and drafts stay in half precision (0.9 GB for 500 000 rows).

    Args:
        folders: The corpus, or several, as of several hands.
        split: `train` or `tune`.
        layout: How the controller sees the fingers of all these hands; as of the corpus' hand if None. All
            columns are in its terms.

    Raises:
        DexFlexError: If the split may not be read, is empty or damaged, or mixes hands.
    """

    def __init__(self, folders: Path | Sequence[Path], split: str, layout: Layout | None = None) -> None:
        parts: list[dict[str, Tensor]] = []
        episodes = 0
        for folder in [folders] if isinstance(folders, Path) else folders:
            paths, hand = _shards(folder, split), hand_of(folder)
            layout = layout or layout_of(hand.name)
            for path in paths:
                part = _derived(hand, _read(path, hand))
                part["episode"] = part["episode"].long() + episodes
                episodes = int(part["episode"][-1]) + 1
                parts.append(_seen(layout, hand, part))
        assert layout is not None
        self.layout = layout
        self.columns = {key: torch.cat([part.pop(key) for part in parts]) for key in tuple(parts[0])}
        touch = self.columns["tactile"].view(len(self), layout.n_fingers, -1)
        self._touch_loads = torch.cat([part.float().sum(-1) for part in touch.split(50_000)])
        self._geometry = torch.zeros(len(layout.hands), layout.n_fingers, 0)
        if isinstance(layout, SharedLayout):
            self._geometry = torch.stack([view_of(layout, hand).geometry for hand in layout.hands])

    def __len__(self) -> int:
        return len(self.columns["step"])

    def history(self, rows: Tensor) -> History:
        """Return the states at some rows with their past."""
        columns, step = self.columns, self.columns["step"][rows]
        fast, slow = past_rows(rows, step, FRAMES), past_rows(rows, step, SLOW_OFFSETS)
        touch = columns["tactile"][fast].float()
        return History(
            joints=columns["joints"][fast],
            fingertips=columns["fingertips"][fast],
            gravity=columns["gravity"][rows],
            tactile=touch.unflatten(-1, (self.layout.n_fingers, *self.layout.taxels)),
            tactile_missing=columns["absent"][rows],
            slow_loads=self._touch_loads[slow],
            slow_fingertips=columns["fingertips"][slow],
            slow_missing=torch.zeros(len(rows), dtype=torch.bool),
            rotations=columns["rotations"][rows],
            geometry=self._geometry[columns["hand"][rows].long()],
        )

    def plan(self, rows: Tensor) -> Tensor:
        """Return where the operator wants the tips, minus where they are [m] (batch, 8, fingers, 3)."""
        return self.columns["plan"][rows].float()

    def draft(self, rows: Tensor) -> Tensor:
        """Return what was left of the operator's plan [m]. Shape (batch, 8, fingers, 3)."""
        return self.columns["draft"][rows].float()

    def executed(self, rows: Tensor) -> Tensor:
        """Return where commands wanted the tips over the next steps, minus where they are [m].

        Rows as in `transition_rows`. Shape (batch, 8, fingers, 3).
        """
        ahead = self.columns["wanted"][rows[:, None] + torch.arange(DRAFT_HORIZON)]
        return ahead - self.columns["fingertips"][rows][:, None]

    def drafts_before(self, rows: Tensor) -> Tensor:
        """Return first steps of the drafts before each row, oldest first, zeros before the start.

        Shape (batch, 8, fingers, 3) [m].
        """
        back = torch.arange(DRAFT_HISTORY, 0, -1)
        known = back <= self.columns["step"][rows].long()[:, None]
        values = self.columns["draft"][(rows[:, None] - back).clamp(min=0), 0].float()
        return values * known[..., None, None]

    def local_forces(self, rows: Tensor) -> Tensor:
        """Return the wanted forces in the frames of `History.rotations` [N]. Shape (batch, fingers, 3)."""
        return (self.columns["rotations"][rows].mT @ self.columns["forces"][rows][..., None]).squeeze(-1)

    def continuing(self, steps: int) -> Tensor:
        """Return which rows have so many further rows in their episode. Shape (rows,), bool."""
        episode = self.columns["episode"]
        mask = torch.zeros(len(self), dtype=torch.bool)
        if len(self) > steps:
            mask[: len(self) - steps] = episode[steps:] == episode[: len(self) - steps]
        return mask

    def rows(self) -> Tensor:
        """Return rows whose object was not lost before them: elsewhere there is nothing to learn."""
        lost, step = self.columns["lost"], self.columns["step"]
        return (~(lost.roll(1) & (step > 0))).nonzero().flatten()

    def transition_rows(self) -> Tensor:
        """Return `rows` whose episode still runs a horizon later."""
        rows = self.rows()
        return rows[self.continuing(DRAFT_HORIZON)[rows]]


def _all_shards(folder: Path) -> list[Path]:
    """Return the shards of all splits that training reads."""
    return sorted(path for split in SPLITS for path in (folder / split).glob("*.safetensors"))


def hand_of(folder: Path) -> Hand:
    """Return the hand of all shards that training reads."""
    first: dict[str, Path] = {}
    for path in _all_shards(folder) or _shards(folder, SPLITS[0]):  # Without any, the latter says so.
        first.setdefault(read_header(path)["hand"], path)
    if len(first) > 1:
        found = ", ".join(f"{path} is of '{hand}'" for hand, path in first.items())
        raise DexFlexError(f"The corpus mixes hands: {found}. Give every hand its own corpus.")
    return get_hand(*first)


def corpus_digest(*folders: Path) -> str:
    """Return a digest of the splits that training reads, by their files' names, sizes and headers."""
    words = []
    for folder in folders:
        for path in _all_shards(folder):
            with path.open("rb") as file:
                length = int.from_bytes(file.read(8), "little")
                header = file.read(length).decode(errors="replace")
            words.append(f"{path.relative_to(folder).as_posix()} {path.stat().st_size} {header}")
    return digest_text("\n".join(words))


def _shards(folder: Path, split: str) -> list[Path]:
    if split not in SPLITS:
        raise DexFlexError(f"Training reads the splits {', '.join(SPLITS)}, not {split!r}.")
    paths = sorted((folder / split).glob("*.safetensors"))
    if not paths:
        raise DexFlexError(
            f"There are no shards in {folder / split}. Make a corpus first, or name one with `--corpus`."
        )
    return paths


def _read(path: Path, hand: Hand) -> dict[str, Tensor]:
    keys = tuple(columns(hand))
    try:
        with safe_open(path, "pt") as shard:
            missing = sorted(set(keys) - set(shard.keys()))
            if missing:
                raise DexFlexError(f"{path} is not a shard of the corpus: it lacks {missing}. Make it again.")
            tensors = {key: shard.get_tensor(key) for key in keys}
    except (SafetensorError, OSError) as error:
        raise DexFlexError(f"{path} cannot be read ({error}). Make it again.") from error
    if not len(tensors[keys[0]]):
        raise DexFlexError(f"{path} is empty. Delete it or make it again.")
    return tensors


def _derived(hand: Hand, shard: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return a shard with what follows from its columns, and without what nothing else is learned from."""
    joints, pose = shard["joints"], shard.pop("object")
    shard["rotations"] = finger_frames(hand, joints).distal_rotation
    shard["squeeze"] = squeeze_of(hand, joints, shard["forces"])
    shard["in_object"] = tips_in_object(pose, shard["fingertips"])
    shard["absent"] = torch.zeros(len(joints), hand.n_fingers, dtype=torch.bool)
    return shard


def squeeze_of(hand: Hand, joints: Tensor, forces: Tensor) -> Tensor:
    """Return by how much fingertips must be commanded into an object to press it [m], float32.

    Args:
        hand: Whose fingertips.
        joints: Measured [rad]. Shape (batch, joints).
        forces: Of the fingers on the object, palm frame [N]. Shape (batch, fingers, 3).
    """
    torques = contact_torques(hand, joints, pads(hand, joints)[0], forces)
    return (fingertips(hand, joints + leads(hand, torques)) - fingertips(hand, joints)).float()


def tips_in_object(pose: Tensor, tips: Tensor) -> Tensor:
    """Return fingertips (rows, fingers, 3) in the frame of an object, whose pose is (rows, 7) [m]."""
    w, v = pose[:, None, 3:4], -pose[:, None, 4:]  # The inverse rotation.
    arm = tips - pose[:, None, :3]
    twice = 2 * torch.linalg.cross(v.expand_as(arm), arm)
    return arm + w * twice + torch.linalg.cross(v.expand_as(arm), twice)


def _seen(layout: Layout, hand: Hand, shard: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return a shard as a layout has its hand, and which of the layout's hands that is."""
    shard["hand"] = torch.full((len(shard["step"]),), layout.hands.index(hand), dtype=torch.uint8)
    if not isinstance(layout, SharedLayout):
        return shard
    view = view_of(layout, hand)
    touch = shard["tactile"].unflatten(-1, (hand.n_fingers, *hand.taxels))
    shard |= {key: view.points(shard[key]) for key in ("fingertips", "wanted")}
    shard |= {
        key: view.vectors(shard[key].float()).to(shard[key]) for key in ("draft", "plan", "forces", "squeeze")
    }
    shard |= {"loads": view.fingers(shard["loads"]), "in_object": view.spread(shard["in_object"], -2)}
    shard |= {"joints": view.joints(shard["joints"]), "joint_targets": view.joints(shard["joint_targets"])}
    return shard | {
        "gravity": view.direction(shard["gravity"]),
        "tactile": view.taxels(touch).flatten(1),
        "rotations": view.rotations(shard["rotations"]),
        "absent": view.missing(shard["absent"]),
    }
