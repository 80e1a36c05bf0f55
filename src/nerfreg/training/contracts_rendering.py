"""What is wrong with the answers of the hooks between the rays of a step and its rendering.

One line for each mistake, none if nothing is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from numbers import Real

import torch
from torch import Tensor

from nerfreg.hooks import ColorSamples, DensitySamples, OccupancyGrid, Rays, Rendering
from nerfreg.training.contracts import differs, kind, unlike

UNIT = 1e-4
"""By how much a length may differ from 1, or a rotation from an orthogonal matrix."""


def wrong_rays(before: Rays, after: object) -> list[str]:
    """Check what `nerfreg_rays` made of `before`: as many rays, finite, in order, of unit speed.

    Targets and everything that refers to rays by number must be left as they are. What the targets
    count (`target_weights`) may be changed: masks and robust losses do that.
    """
    if not isinstance(after, Rays):
        return [f"returned {kind(after)}, not Rays; return `rays` to leave them as they are"]
    wrong = []
    for name in ("origins", "directions", "near", "far"):
        wrong += unlike(name, getattr(after, name), getattr(before, name))
    if wrong:
        return wrong
    off = (after.directions.detach().norm(dim=1) - 1).abs()
    # Half precision cannot be more exact than its own rounding.
    if len(off) and float(off.max()) > max(UNIT, torch.finfo(off.dtype).eps):
        wrong.append(f"directions: not of unit length, off by up to {float(off.max()):.2g}")
    if after.target_weights is not None:
        model = before.near.new_empty(len(before.targets))
        wrong += unlike("target_weights", after.target_weights, model)
    own = ("origins", "directions", "near", "far", "background", "target_weights")
    for name in (field.name for field in fields(Rays) if field.name not in own):
        given, left = getattr(before, name), getattr(after, name)
        if left is not given and not (isinstance(given, Tensor) and _equal(given, left)):
            wrong.append(f"{name}: is not what it was; leave it")
    return wrong


def wrong_occupancy(answer: object) -> list[str]:
    """Check that `nerfreg_occupancy` returned a grid of cells, all on one device, or None."""
    if answer is None:
        return []
    if not isinstance(answer, OccupancyGrid):
        return [f"returned {kind(answer)}, not an OccupancyGrid"]
    occupied, low, cell = answer.occupied, answer.low, answer.cell
    device = occupied.device if isinstance(occupied, Tensor) else None
    wrong = unlike("low", low, torch.empty(3, device=device))
    if not (isinstance(occupied, Tensor) and occupied.ndim == 3 and occupied.numel()):
        found = f"{tuple(occupied.shape)}" if isinstance(occupied, Tensor) else kind(occupied)
        wrong.append(f"occupied: is {found}, not a tensor (X, Y, Z)")
    else:
        model = torch.empty(occupied.shape, dtype=torch.bool, device=device)
        wrong += differs("occupied", occupied, model)
    if not (isinstance(cell, Real) and 0 < float(cell) < math.inf):
        found = f"{cell}" if isinstance(cell, Real) else kind(cell)
        wrong.append(f"cell: is {found}, not a positive number")
    return wrong


def wrong_empty(positions: Tensor, answer: object) -> list[str]:
    """Check that `nerfreg_empty` tells for each of the positions (P, 3) whether it is empty."""
    if answer is None:
        return []
    return differs("empty", answer, positions.new_empty(len(positions), dtype=torch.bool))


def wrong_density(samples: DensitySamples, answer: object) -> list[str]:
    """Check that `nerfreg_density` returned a density for each sample, (R, N), none negative."""
    if answer is None:
        return ["returned None; return densities (R, N), or `samples.density` to leave them"]
    wrong = unlike("density", answer, samples.density)
    if wrong or not isinstance(answer, Tensor):
        return wrong
    negative = answer.detach() < 0
    if not bool(negative.any()):
        return []
    least = float(answer.detach().min())
    return [f"density: negative at {int(negative.sum())} of {answer.numel()} samples, as {least:g}"]


def wrong_color_input(samples: ColorSamples, answer: object) -> list[str]:
    """Check that `nerfreg_color_input` returned finite features, a row for each of K samples."""
    if answer is None:
        return [f"returned None; return features of all {len(samples.ray)} samples"]
    width = answer.shape[-1] if isinstance(answer, Tensor) and answer.ndim == 2 else 1
    return unlike("features", answer, samples.t.new_empty(len(samples.ray), width))


def wrong_rendering(before: Rendering, after: object) -> list[str]:
    """Check that `nerfreg_rendering` returned a rendering of the same shapes, all finite."""
    if not isinstance(after, Rendering):
        kept = "return `rendering` to leave it as it is"
        return [f"returned {kind(after)}, not a Rendering; {kept}"]
    if after.rays is not before.rays:
        return ["rays: are not what they were; leave them"]
    wrong = []
    for name in (field.name for field in fields(Rendering) if field.name != "rays"):
        given, left = getattr(before, name), getattr(after, name)
        # Colours that were not asked for are NaN, and stay so.
        finite = bool(given.isfinite().all())
        wrong += (unlike if finite else differs)(name, left, given)
    return wrong


def wrong_unseen_poses(answer: object, count: int, views: int) -> list[str]:
    """Check that `nerfreg_unseen_poses` returned camera-to-world matrices, with views or without.

    Args:
        answer: What it returned.
        count: How many poses were asked for.
        views: Number of training views.
    """
    if answer is None:
        return []
    poses, numbers = answer if isinstance(answer, tuple) and len(answer) == 2 else (answer, None)
    wrong = unlike("poses", poses, torch.empty(count, 3, 4))
    if isinstance(poses, Tensor) and not wrong:
        turns = poses[:, :, :3].detach().double()
        identity = torch.eye(3, dtype=torch.float64)
        off = (turns @ turns.mT - identity).abs().amax(dim=(1, 2))
        if count and float(off.max()) > UNIT:
            some = f"{int((off > UNIT).sum())} of {count}"
            wrong.append(f"poses: {some} are no rotations, off by up to {float(off.max()):.2g}")
        elif bool((torch.linalg.det(turns) < 0).any()):
            wrong.append("poses: some are reflections; OpenGL axes are right-handed")
    if numbers is not None:
        wrong += differs("views", numbers, torch.empty(count, dtype=torch.long))
        if isinstance(numbers, Tensor) and bool(((numbers < 0) | (numbers >= views)).any()):
            wrong.append(f"views: must be numbers of training views, 0 to {views - 1}")
    return wrong


def wrong_metrics(answer: object) -> list[str]:
    """Check that `nerfreg_metrics` returned numbers by name, or None."""
    if answer is None:
        return []
    if not isinstance(answer, Mapping):
        return [f"returned {kind(answer)}; return a dict of numbers by name"]
    return [
        f"metric '{name}' is {kind(value)}, not a number; return {name}=float(...)"
        for name, value in answer.items()
        if not isinstance(value, Real)
    ]


def _equal(given: Tensor, left: object) -> bool:
    if not isinstance(left, Tensor) or left.shape != given.shape:
        return False
    return bool(((left == given) | (left.isnan() & given.isnan())).all())
