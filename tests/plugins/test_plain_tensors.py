"""The losses as other programs call them: plain tensors, of the shapes that these have."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from nerfreg_plugins.convex_prior import outside_opacity
from nerfreg_plugins.depth_smoothness import depth_smoothness_loss
from nerfreg_plugins.distortion import distortion_loss
from nerfreg_plugins.entropy import entropy_loss
from nerfreg_plugins.full_geometry import full_geometry_loss, full_geometry_loss_of_thickness
from nerfreg_plugins.kl import kl_loss, kl_loss_of_logs
from nerfreg_plugins.occlusion import occlusion_loss
from nerfreg_plugins.stereo import stereo_loss
from nerfreg_plugins.unseen_smoothness import unseen_smoothness_loss
from torch import Tensor

RAYS, SAMPLES = 6, 9
OUTSIDE = torch.arange(RAYS * SAMPLES).view(RAYS, SAMPLES) % 2 == 0
KNOWN = torch.tensor([[2.5, 3.0]]).repeat(RAYS, 1)


def tau() -> Tensor:
    return 0.1 + torch.rand(RAYS, SAMPLES, generator=torch.Generator().manual_seed(0))


def weights() -> Tensor:
    thickness = tau()
    return torch.exp(thickness - thickness.cumsum(1)) * -torch.expm1(-thickness)


def edges() -> Tensor:
    return torch.linspace(2.0, 6.0, SAMPLES + 1).expand(RAYS, -1)


def patches() -> Tensor:
    return 1 + torch.rand(2, 3, 3, generator=torch.Generator().manual_seed(1))


LOSSES: dict[Callable[..., Tensor], Callable[[], tuple[Tensor, ...]]] = {
    distortion_loss: lambda: (weights(), edges()),
    occlusion_loss: lambda: (weights(), edges()),
    entropy_loss: lambda: (-torch.expm1(-tau()),),
    full_geometry_loss: lambda: (weights(),),
    full_geometry_loss_of_thickness: lambda: (tau(),),
    kl_loss: lambda: (weights(), weights().flip(0)),
    stereo_loss: lambda: (weights(), edges()),
    outside_opacity: lambda: (tau(), OUTSIDE),
    depth_smoothness_loss: lambda: (patches(),),
    unseen_smoothness_loss: lambda: (patches(),),
}
every_loss = pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.__name__)


def called(loss: Callable[..., Tensor], *given: Tensor) -> Tensor:
    return loss(*given, known_depth=KNOWN) if loss is stereo_loss else loss(*given)


@every_loss
def test_a_last_axis_of_one_changes_nothing(loss: Callable[..., Tensor]) -> None:
    given = LOSSES[loss]()
    value = called(loss, *given)
    assert value.shape == ()
    assert value > 0
    assert torch.equal(called(loss, *(x[..., None] for x in given)), value)


@every_loss
def test_precision_stays(loss: Callable[..., Tensor]) -> None:
    for dtype in (torch.float32, torch.float64):
        assert (
            called(
                loss, *(x.to(dtype) if x.is_floating_point() else x for x in LOSSES[loss]())
            ).dtype
            == dtype
        )


def test_distortion_finds_the_depth_itself() -> None:
    # Depth of weights 1/4 and 1/2 in the middle of (0, 2) and (2, 4): (1/4 + 3/2) / (3/4) = 7/3.
    # The ray without weight has none, and counts as 0.
    given = torch.tensor([[0.25, 0.5], [0.0, 0.0]], requires_grad=True)
    borders = torch.tensor([[0.0, 2.0, 4.0]]).expand(2, -1)
    spread = 2 * 2 * 0.25 * 0.5 + (0.0625 + 0.25) * 2 / 3
    value = distortion_loss(given, borders)
    assert value.item() == pytest.approx(spread / (7 / 3) / 2)
    assert torch.autograd.grad(value, given)[0].isfinite().all()


def test_occlusion_takes_the_ends_from_the_borders() -> None:
    ends = edges()[:, 0], edges()[:, -1]
    given = torch.equal(
        occlusion_loss(weights(), edges()), occlusion_loss(weights(), edges(), *ends)
    )
    assert given


def test_divergence_of_weights_is_that_of_their_logarithms() -> None:
    ray, neighbor = weights().double(), weights().flip(0).double()
    expected = kl_loss_of_logs(ray.log(), neighbor.log())
    torch.testing.assert_close(kl_loss(ray, neighbor), expected, rtol=1e-12, atol=0)


def test_divergence_of_weights_that_are_zero() -> None:
    # p = (1/2, 1/2, 0) and q = (1/4, 3/4, 0): log(2) / 2 + log(2/3) / 2. The second pair has an
    # empty ray and counts as 0.
    ray = torch.tensor([[0.1, 0.1, 0.0], [1e-6, 0.0, 0.0]], requires_grad=True)
    neighbor = torch.tensor([[0.1, 0.3, 0.0], [0.5, 0.5, 0.0]], requires_grad=True)
    value = kl_loss(ray, neighbor)
    assert value.item() == pytest.approx((math.log(2) + math.log(2 / 3)) / 4, rel=1e-6)
    for grad in torch.autograd.grad(value, (ray, neighbor)):
        assert grad.isfinite().all()
        assert grad[0, :2].all()
        assert not grad[:, 2].any()


def test_known_depth_without_optical_thickness() -> None:
    value = stereo_loss(weights().double(), edges().double(), KNOWN.double())
    exact = stereo_loss(weights().double(), edges().double(), KNOWN.double(), tau=tau().double())
    torch.testing.assert_close(value, exact, rtol=1e-6, atol=0)
    given = weights().double().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda w: stereo_loss(w, edges().double(), KNOWN.double()), given
    )
