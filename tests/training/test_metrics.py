import math

import torch

from lerobot_dexflex.training.metrics import choose, roc_auc


def test_auc_of_perfect_random_and_tied_scores():
    positive = torch.tensor([False, False, True, True])
    assert roc_auc(torch.tensor([0.1, 0.2, 0.3, 0.4]), positive) == 1
    assert roc_auc(torch.tensor([0.4, 0.3, 0.2, 0.1]), positive) == 0
    assert roc_auc(torch.zeros(4), positive) == 0.5
    assert math.isnan(roc_auc(torch.zeros(2), torch.tensor([True, True])))


def test_chosen_rows_are_always_the_same():
    rows = torch.arange(100)
    assert torch.equal(choose(rows, 10), choose(rows, 10))
    assert len(choose(rows, 200)) == 100
