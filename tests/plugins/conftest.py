"""Rays that are composited by hand, so that no plugin test depends on the renderer."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from nerfreg import Rays, Rendering, Step

FAR = 6.0


def make_rendering(tau: Tensor, t_edges: Tensor | None = None, **rays: Tensor) -> Rendering:
    """Rays of optical thickness tau (R, N), black before a white background."""
    count, samples = tau.shape
    if t_edges is None:
        t_edges = torch.linspace(2.0, FAR, samples + 1, dtype=tau.dtype).expand(count, -1)
    log_transmittance = -(tau.cumsum(-1) - tau)
    weights = log_transmittance.exp() * -torch.expm1(-tau)
    opacity = -torch.expm1(-tau.sum(-1))
    t = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    seen = opacity >= 1e-4
    depth = torch.where(
        seen, (weights * t).sum(-1) / torch.where(seen, weights.sum(-1), 1.0), t_edges[:, -1]
    )
    direction = torch.tensor([0.0, 0.0, -1.0], dtype=tau.dtype)
    return Rendering(
        rays=Rays(
            origins=tau.new_zeros(count, 3),
            directions=direction.expand(count, 3),
            near=t_edges[:, 0],
            far=t_edges[:, -1],
            targets=rays.pop("targets", tau.new_zeros(count, 3)),
            **rays,
        ),
        t_edges=t_edges,
        t=t,
        density=tau / t_edges.diff(dim=-1),
        tau=tau,
        log_transmittance=log_transmittance,
        weights=weights,
        opacity=opacity,
        depth=depth,
        rgb=(1 - opacity)[:, None].expand(count, 3),
        colored=weights > 1e-4,
    )


def make_step(
    fraction: float = 0.5,
    index: int = 500,
    rerender: Callable[[Rendering], Rendering] = lambda rendering: rendering,
) -> Step:
    """Step `index` of 1000 in a scene from 2 to 6."""
    renderer = SimpleNamespace(
        render=lambda rays, step, like, **options: rerender(like),
        frozen=nullcontext,
        cast=lambda rays, step: rays,
        view=lambda step: None,
    )
    generator = torch.Generator().manual_seed(0)
    return Step(index, 1000, fraction, generator, (2.0, FAR), renderer)


def gradients(value: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
    """The gradients of a scalar, after a check that it and they are finite."""
    assert value.ndim == 0
    assert value.isfinite(), value
    grads = torch.autograd.grad(value, inputs)
    assert all(grad.isfinite().all() for grad in grads), grads
    return grads


@pytest.fixture(params=[torch.float32, torch.float64], ids=str)
def dtype(request: pytest.FixtureRequest) -> torch.dtype:
    return request.param


@pytest.fixture
def rendering() -> Callable[..., Rendering]:
    return make_rendering


@pytest.fixture
def step() -> Callable[..., Step]:
    return make_step


@pytest.fixture
def finite_gradients() -> Callable[..., tuple[Tensor, ...]]:
    return gradients
