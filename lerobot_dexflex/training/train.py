"""Train all stages of a controller in sequence, each frozen for the next."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from lerobot_dexflex.controller.checkpoint import find
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.controller.layout import BETWEEN, SharedLayout
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import weights_digest
from lerobot_dexflex.training.bank import BankConfig, ProposalBank
from lerobot_dexflex.training.claim import claim
from lerobot_dexflex.training.corpus_data import CorpusData, corpus_digest, hand_of
from lerobot_dexflex.training.diffusion_prior import DexGenConfig, DexGenStage
from lerobot_dexflex.training.encoder_prior import EncoderPriorConfig, EncoderPriorStage, part
from lerobot_dexflex.training.fit import DONE, FitConfig, Stage, fit, load_finished
from lerobot_dexflex.training.score import ScoreConfig, ScoreStage
from lerobot_dexflex.training.splitter import SplitterConfig, SplitterStage
from lerobot_dexflex.training.world_model import WorldModelConfig, WorldModelStage

STAGES = ("encoder_prior", "world_model", "score", "splitter", "dexgen")
"""In this order; `dexgen` is the baseline's."""
_NEED_THE_FIRST_ONLY = ("splitter", "dexgen")

_PARTS: dict[str, Callable[["Trainer"], nn.Module]] = {
    "encoder_prior": lambda trainer: part(trainer.controller),
    "world_model": lambda trainer: trainer.controller.world_model,
    "score": lambda trainer: trainer.controller.ranker,
    "splitter": lambda trainer: trainer.controller.splitter,
    "dexgen": lambda trainer: trainer.dexgen,
}
"""What each stage decides."""


@dataclass
class NetworkConfig:
    """What of the controller may be chosen."""

    hand: str = ""
    """The hand, or hands with `+` between them; by default those of the corpora. More may be named, which the
    controller is to learn later."""
    use_touch: bool = True
    """Train and run with touch."""
    use_slow: bool = True
    """Train and run with the slow token."""
    largest_force: float = 8.0
    """Bound of a finger's force [N]."""


@dataclass
class TrainConfig:
    """Train a controller from a corpus."""

    corpus: Path = Path("outputs/corpus/reach")
    """The corpus; its test split is never read."""
    beside: list[Path] = field(default_factory=list)
    """Corpora of further hands, from which the same controller learns as well."""
    output: Path = Path("outputs/controller")
    """Folder of states, metrics and, in `controller`, the result. Run again to continue."""
    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Stages to train; the others keep the weights of `init_from`."""
    init_from: str = ""
    """Controller to start from: a folder or a Hub name."""
    seed: int = 0
    """Seed of initial weights and of all draws."""
    threads: int = 1
    """Threads of torch."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    bank: BankConfig = field(default_factory=BankConfig)
    encoder_prior: EncoderPriorConfig = field(default_factory=EncoderPriorConfig)
    world_model: WorldModelConfig = field(default_factory=WorldModelConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    splitter: SplitterConfig = field(default_factory=SplitterConfig)
    dexgen: DexGenConfig = field(default_factory=DexGenConfig)

    def __post_init__(self) -> None:
        self.corpus, self.output = Path(self.corpus), Path(self.output)
        self.beside = [Path(folder) for folder in self.beside]
        unknown = sorted(set(self.stages) - set(STAGES))
        if unknown or not self.stages:
            raise DexFlexError(f"`stages` must name some of {', '.join(STAGES)}. Got {self.stages}.")
        first = STAGES.index(next(s for s in STAGES if s in self.stages))
        if first and not self.init_from:
            before = _before(STAGES[first])[-1]
            raise DexFlexError(f"Without `{before}` in `stages`, name a trained controller with `init_from`.")
        if min(self.bank.rows, self.bank.held_out_rows) < 1 or self.threads < 1:
            raise DexFlexError("`bank.rows`, `bank.held_out_rows` and `threads` must be at least 1.")

    @property
    def corpora(self) -> list[Path]:
        """All corpora, one for each hand."""
        return [self.corpus, *self.beside]


class Trainer:
    """All that the stages share: data and the controller in the making."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        names = [hand_of(folder).name for folder in config.corpora]
        torch.manual_seed(config.seed)
        if config.init_from:
            self.controller = DexFlexController.from_pretrained(config.init_from)
        else:
            network = asdict(config.network)
            network["hand"] = network["hand"] or BETWEEN.join(dict.fromkeys(names))
            self.controller = DexFlexController(ControllerConfig(**network))
        layout = self.controller.config.layout
        _check_hands(self.controller.config, names, config)
        if isinstance(layout, SharedLayout) and "dexgen" in config.stages:
            raise DexFlexError(
                "DexGen, the baseline, is trained for one hand. Leave `dexgen` out of `stages`: "
                f"--stages=[{','.join(STAGES[:-1])}]."
            )
        self.train, self.tune = (CorpusData(config.corpora, split, layout) for split in ("train", "tune"))
        self.controller.eval().requires_grad_(False)
        self.dexgen = DiffusionPrior(self.controller.config)

    def stage(self, name: str) -> tuple[Stage, FitConfig]:
        """Return a stage and how to train it; all before it must be trained."""
        config, controller = self.config, self.controller
        if name == "encoder_prior":
            settings = config.encoder_prior
            return EncoderPriorStage(controller, self.train, self.tune, settings), settings.fit
        if name == "world_model":
            settings = config.world_model
            return WorldModelStage(controller, self.train, self.tune, settings), settings.fit
        if name == "splitter":
            settings = config.splitter
            return SplitterStage(controller, self.train, self.tune, settings), settings.fit
        if name == "dexgen":
            settings = config.dexgen
            return DexGenStage(controller, self.dexgen, self.train, self.tune, settings), settings.fit
        train_bank, tune_bank = self._banks()
        return ScoreStage(controller, train_bank, tune_bank, config.score), config.score.fit

    def _banks(self) -> tuple[ProposalBank, ProposalBank]:
        config, folder = self.config.bank, self.config.output / "bank"
        splits = {"train": (self.train, config.rows), "tune": (self.tune, config.held_out_rows)}
        origin = json.dumps(self.before("score"))
        train, tune = (
            ProposalBank.load_or_draw(
                folder / f"{split}.safetensors", self.controller, data, config, rows, self.config.seed, origin
            )
            for split, (data, rows) in splits.items()
        )
        return train, tune

    def before(self, name: str) -> dict[str, Any]:
        """Return digests of all that a stage starts from: the corpus, earlier stages, or a controller."""
        config = self.config
        files = {stage: config.output / stage / DONE for stage in _before(name) if stage in config.stages}
        start = find(config.init_from) if config.init_from else None
        return {
            "corpus": corpus_digest(*config.corpora),
            "init_from": weights_digest([start.config, start.weights]) if start else "",
            "after": {stage: weights_digest([file]) for stage, file in files.items()},
        }

    def settings(self, name: str) -> dict[str, Any]:
        """Return everything on which a stage's weights depend, as plain values."""
        config = self.config
        own: dict[str, Any] = {name: asdict(getattr(config, name))}
        if name == "score":
            own["bank"] = asdict(config.bank)
        shared = {
            "seed": config.seed,
            "network": asdict(config.network),
        }
        return shared | own | self.before(name)


def _check_hands(controller: ControllerConfig, names: list[str], config: TrainConfig) -> None:
    known = [hand.name for hand in controller.layout.hands]
    for name, folder in zip(names, config.corpora, strict=True):
        if name in known:
            continue
        if config.init_from:
            raise DexFlexError(
                f"The controller in {config.init_from} was trained for '{controller.hand}', but the corpus "
                f"in {folder} is of '{name}'. Name a controller of '{name}' with `init_from`, or leave it "
                "out to train all stages."
            )
        raise DexFlexError(
            f"`network.hand` is '{controller.hand}', but the corpus in {folder} is of '{name}'. Name it as "
            "well, with `+` between hands, or leave `network.hand` out to take those of the corpora."
        )


def _before(name: str) -> tuple[str, ...]:
    """Return the stages on which a stage builds."""
    return STAGES[: 1 if name in _NEED_THE_FIRST_ONLY else STAGES.index(name)]


def train(config: TrainConfig) -> Path:
    """Train what is not yet trained and assemble the controller; returns its folder.

    Raises:
        DexFlexError: If the corpus or a setting does not fit, or the folder holds stages of other settings.
        KeyboardInterrupt: After an interrupt; run again to continue.
    """
    with locked(config.output):
        return _train(config)


def _train(config: TrainConfig) -> Path:
    torch.set_num_threads(config.threads)
    trainer = Trainer(config)
    controller = trainer.controller
    record: dict[str, Any] = {k: v for k, v in controller.record.items() if k in STAGES}
    for name in STAGES:
        if name not in config.stages:
            continue
        folder = config.output / name
        claim(folder, trainer.settings(name))
        metrics = load_finished(_PARTS[name](trainer), folder)
        if metrics is None:
            stage, how = trainer.stage(name)
            metrics = fit(stage, how, folder, config.seed)
            stage.network.load_state_dict(stage.average.state_dict())
            stage.network.eval().requires_grad_(False)
        record[name] = metrics
    controller.record = {
        "corpus": ", ".join(folder.as_posix() for folder in config.corpora),
        "seed": config.seed,
    } | record
    controller.save_pretrained(config.output / "controller")
    if "dexgen" in config.stages:
        trainer.dexgen.save(config.output / "controller")
    return config.output / "controller"
