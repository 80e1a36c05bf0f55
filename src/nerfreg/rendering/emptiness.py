"""Which parts of rays plugins leave to be sampled, by grids of cells or by a function."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from nerfreg.hooks import Rays, Step
from nerfreg.rays.traversal import Runs, occupied_runs, runs_of_parts
from nerfreg.rendering.render_hooks import RenderHooks

PROBES = 128
"""Parts of a ray in whose middles a function is asked whether space is empty."""


def sampled_runs(
    hooks: RenderHooks, rays: Rays, near: Tensor, far: Tensor, step: Step
) -> Runs | None:
    """Return the parts of rays that are not declared empty; None if no plugin declares anything.

    A single grid is followed exactly. Functions, and several grids, are asked at `PROBES` points of
    each ray, and parts beside one that is not empty are sampled as well, since a border may lie
    anywhere between two points. Samples there that are in empty space are not evaluated.

    A plugin that answers nothing in this step declares nothing.

    Args:
        hooks: The hooks of the run.
        rays: R rays.
        near: (R,) where each ray begins.
        far: (R,) where it ends.
        step: Where the run stands.
    """
    grids, asked = hooks.occupancy(step), hooks.changes("nerfreg_empty", step)
    if not grids and not asked:
        return None
    if len(grids) == 1 and not asked:
        return occupied_runs(grids[0], rays.origins.detach(), rays.directions.detach(), near, far)
    shares = torch.linspace(0, 1, PROBES + 1, dtype=near.dtype, device=near.device)
    borders = torch.lerp(near[:, None], far.maximum(near)[:, None], shares)
    t = (borders[:, 1:] + borders[:, :-1]) / 2
    positions = rays.origins[:, None] + rays.directions[:, None] * t[..., None]
    empty = hooks.empty(positions.detach().view(-1, 3), step)
    if empty is None:
        return None
    full = (~empty).view(t.shape).to(near.dtype)
    return runs_of_parts(borders, functional.max_pool1d(full, 3, stride=1, padding=1) > 0)
