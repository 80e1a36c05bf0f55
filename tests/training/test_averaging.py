"""The moving average of the weights."""

from __future__ import annotations

import torch
from torch import nn

from nerfreg.training.averaging import MovingAverage


def test_average_by_hand_and_the_own_weights_come_back() -> None:
    module = nn.Linear(1, 1, bias=False)
    with torch.no_grad():
        module.weight.fill_(1.0)
    average = MovingAverage(module, 0.9)
    with torch.no_grad():
        module.weight.fill_(3.0)
    average.update()
    # the first decay is (1 + 1) / (10 + 1) = 2/11, hence 1 * 2/11 + 3 * 9/11 = 29/11
    with average.applied():
        torch.testing.assert_close(module.weight.data, torch.tensor([[29 / 11]]))
    assert module.weight.item() == 3.0


def test_a_decay_of_zero_keeps_the_weights_and_no_copy() -> None:
    module = nn.Linear(2, 2)
    average = MovingAverage(module, 0.0)
    average.update()
    before = module.weight.clone()
    with average.applied():
        assert torch.equal(module.weight, before)
    assert average.averages == []
