import json
import os
import signal

import pytest
import torch
from torch import nn

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.fit import FitConfig, Stage, fit, load_finished


class Line(Stage):
    """Fit a line; may be interrupted or broken at a step."""

    name = "line"

    def __init__(self, interrupt_at=-1, break_at=-1):
        torch.manual_seed(3)
        super().__init__(nn.Linear(2, 1))
        self.count, self.interrupt_at, self.break_at = 0, interrupt_at, break_at

    def batch(self):
        return torch.randn(16, 2)

    def loss(self, batch):
        self.count += 1
        if self.count == self.interrupt_at:
            os.kill(os.getpid(), signal.SIGINT)
        target = batch.sum(1, keepdim=True)
        loss = (self.network(batch) - target).square().mean()
        if self.count == self.break_at:
            loss = loss * torch.nan
        return loss, {"part": loss.detach()}

    def evaluate(self):
        torch.rand(5)  # Evaluation must not disturb training's draws.
        return {"slope": float(self.average.get_parameter("weight").sum()), "undefined": float("nan")}


HOW = FitConfig(steps=60, lr=0.05, warmup_steps=5, evaluate_every=20)


def test_training_learns_and_leaves_curves(tmp_path):
    metrics = fit(Line(), FitConfig(steps=300, lr=0.05, warmup_steps=5), tmp_path, 0)
    assert metrics == {"slope": pytest.approx(2, abs=0.1)}
    assert {p.name for p in tmp_path.iterdir()} == {"weights.pt", "metrics.jsonl", "metrics.png"}
    entries = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert entries[-1]["held_out"] == metrics


def test_interrupted_training_ends_as_if_it_never_was(tmp_path):
    whole = Line()
    fit(whole, HOW, tmp_path / "whole", 0)
    with pytest.raises(KeyboardInterrupt):
        fit(Line(interrupt_at=25), HOW, tmp_path / "parts", 0)
    assert (tmp_path / "parts/resume.pt").is_file()
    resumed = Line()
    fit(resumed, HOW, tmp_path / "parts", 0)
    assert resumed.count == 35
    for a, b in zip(whole.average.parameters(), resumed.average.parameters(), strict=True):
        assert torch.equal(a, b)


def test_finished_weights_are_loaded_and_must_fit(tmp_path):
    assert load_finished(nn.Linear(2, 1), tmp_path) is None
    stage = Line()
    metrics = fit(stage, HOW, tmp_path, 0)
    network = nn.Linear(2, 1)
    assert load_finished(network, tmp_path) == metrics
    assert torch.equal(network.weight, stage.average.get_parameter("weight"))
    with pytest.raises(DexFlexError, match="another"):
        load_finished(nn.Linear(3, 1), tmp_path)


def test_training_stops_after_its_minutes_with_the_rate_run_down(tmp_path):
    stage = Line()
    fit(stage, FitConfig(steps=10**6, max_minutes=0.002), tmp_path, 0)
    assert 0 < stage.count < 10**6


def test_divergence_is_reported(tmp_path):
    with pytest.raises(DexFlexError, match="line diverged at step 9"):
        fit(Line(break_at=10), HOW, tmp_path, 0)
