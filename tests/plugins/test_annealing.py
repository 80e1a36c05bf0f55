from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.annealing import Annealing, annealed_bounds

from nerfreg import NerfregError
from nerfreg.registry import Hooks


@pytest.mark.parametrize(
    ("step", "steps", "start", "mid", "expected"),
    [
        # t_m = 4 between 2 and 6: eta = 1/2, then 3/4, then 1.
        (0, 100, 0.5, 0.5, (3.0, 5.0)),
        (75, 100, 0.5, 0.5, (2.5, 5.5)),
        (100, 100, 0.5, 0.5, (2.0, 6.0)),
        (1000, 100, 0.5, 0.5, (2.0, 6.0)),
        # t_m at near, and at far.
        (0, 100, 0.25, 0.0, (2.0, 3.0)),
        (0, 100, 0.25, 1.0, (5.0, 6.0)),
        # Nothing to grow.
        (0, 100, 1.0, 0.5, (2.0, 6.0)),
        (0, 0, 0.5, 0.5, (2.0, 6.0)),
    ],
)
def test_by_hand(dtype, step, steps, start, mid, expected):
    near, far = torch.tensor([2.0], dtype=dtype), torch.tensor([6.0], dtype=dtype)
    new = annealed_bounds(near, far, step, steps, start, mid)
    assert (new[0].item(), new[1].item()) == expected
    assert new[0].dtype == dtype


def test_the_bounds_come_back_exactly(dtype):
    near, length = torch.rand(2, 1000, dtype=dtype, generator=torch.Generator().manual_seed(0))
    far = near + length
    new = annealed_bounds(near, far, 7, 7, 0.5, 0.3)
    assert torch.equal(new[0], near)
    assert torch.equal(new[1], far)


def test_the_last_steps_keep_their_digits(dtype):
    # near 0, far 1, mid 1/2: t_n = (1 - eta) / 2 with eta = 1 - 1e-6, not a difference of two
    # numbers near 1/2.
    near, far = torch.zeros(1, dtype=dtype), torch.ones(1, dtype=dtype)
    new_near, _ = annealed_bounds(near, far, 999_999, 1_000_000, 0.5, 0.5)
    assert new_near.item() == pytest.approx(5e-7, rel=1e-6 if dtype == torch.float32 else 1e-9)


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    near, far = torch.tensor([2.0], dtype=half), torch.tensor([6.0], dtype=half)
    new = annealed_bounds(near, far, 1, 3, 0.1, 0.3)
    for value, full in zip(
        new, annealed_bounds(near.float(), far.float(), 1, 3, 0.1, 0.3), strict=True
    ):
        assert torch.equal(value, full.to(half))


@pytest.mark.parametrize("start", [1e-30, 1e-3, 0.9])
def test_bounds_stay_in_order_and_inside(dtype, start):
    near, length = torch.rand(2, 1000, dtype=dtype, generator=torch.Generator().manual_seed(0))
    far = near + length
    new = annealed_bounds(near, far, 0, 10, start, 0.37)
    slack = 1e-6
    assert (near - slack <= new[0]).all()
    assert (new[0] <= new[1] + slack).all()
    assert (new[1] <= far + slack).all()


def test_gradcheck():
    near, far = torch.tensor([[1.0, 2.0], [3.0, 5.0]], dtype=torch.float64)
    inputs = (near.requires_grad_(), far.requires_grad_())
    assert torch.autograd.gradcheck(lambda a, b: annealed_bounds(a, b, 3, 10, 0.1, 0.5), inputs)


@pytest.mark.parametrize(
    ("duration", "expected"),
    # A quarter of the budget at step 30: eta = 1/4 / 1/2, or 30/40.
    [(0.5, (3.0, 5.0)), (40, (2.5, 5.5))],
)
def test_ray_bounds(rendering, step, duration, expected):
    plugin = Annealing(duration=duration, initial=0.1)
    rays = rendering(torch.ones(3, 4)).rays
    near, far = Hooks({"annealing": plugin}).ray_bounds(rays, step(fraction=0.25, index=30))
    assert near.tolist() == [expected[0]] * 3
    assert far.tolist() == [expected[1]] * 3
    assert rays.near.tolist() == [2.0] * 3


@pytest.mark.parametrize(
    ("key", "value"), [("initial", 0.0), ("initial", 1.5), ("mid", -0.1), ("mid", 1.1)]
)
def test_what_cannot_work_is_refused(key, value):
    with pytest.raises(NerfregError, match=rf"reg\.annealing\.{key}.*{value}"):
        Annealing(**{key: value})
