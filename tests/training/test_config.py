"""Values of the optimizer under which a step could have no limit are refused."""

from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from nerfreg.errors import NerfregError
from nerfreg.training import OptimConfig, TrainConfig


@pytest.mark.parametrize(
    "config, values, message",
    [
        (OptimConfig, {"lr": 1e7}, "optim.lr=10000000.0: must be between 1e-20 and 1e+06"),
        (OptimConfig, {"lr": math.inf}, "optim.lr=inf: must be between 1e-20 and 1e+06"),
        (OptimConfig, {"decay": 1e9}, "optim.decay=1000000000.0: must be between 1e-20 and 1e+06"),
        (
            OptimConfig,
            {"beta1": 0.9, "beta2": 0.8},
            "optim.beta1=0.9: its square must be below optim.beta2=0.8",
        ),
        (TrainConfig, {"check_every": 0}, "train.check_every=0: must be at least 1"),
    ],
)
def test_refused(config: type, values: dict[str, float], message: str) -> None:
    with pytest.raises(NerfregError) as error:
        config(**values)
    assert str(error.value).startswith(message)


def test_a_longer_run_slows_down_more() -> None:
    assert OptimConfig(lr=0.01).rate(1.0, 1000) == pytest.approx(0.005)
    assert OptimConfig(lr=0.01).rate(1.0, 9000) == pytest.approx(0.001)  # as the authors' program
    assert OptimConfig(lr=0.01).rate(0.5, 3000) == pytest.approx(
        0.005
    )  # a quarter at the end, half of the way
    assert OptimConfig(lr=0.01, decay=0.04).rate(0.5, 9000) == pytest.approx(0.002)


def test_no_memory_at_all_is_fine() -> None:
    assert OptimConfig(beta1=0.0, beta2=0.0).beta1 == 0.0


def test_a_step_keeps_the_limit_that_the_docstring_promises() -> None:
    # The Cauchy-Schwarz inequality is an equality for gradients that grow by beta2 / beta1 in every
    # step.
    config = OptimConfig()
    b1, b2 = config.beta1, config.beta2
    limit = config.lr * (1 - b1) / math.sqrt((1 - b2) * (1 - b1**2 / b2))
    weight = nn.Parameter(torch.zeros(1))
    adam = torch.optim.Adam([weight], lr=config.lr, betas=(b1, b2), eps=config.eps, fused=True)
    moves = []
    for step in range(400):
        before = weight.item()
        weight.grad = torch.tensor([1e-10 * (b2 / b1) ** step])
        adam.step()
        moves.append(abs(weight.item() - before))
    # Adam's bias correction is 1.01 then.
    assert moves[-1] == pytest.approx(limit, rel=0.02)
    assert max(moves) < 1.02 * limit
