"""Whether features that a plugin masks have no influence on a real field: its outputs, its gradients."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from nerfreg.field import FieldConfig
from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid_layout import FEATURES
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Samples
from nerfreg.registry import Hooks

BACKENDS = ("torch", "numba")
LEVELS, GEOMETRY = 4, 3
GRID_WIDTH = FEATURES * LEVELS


def wrong_masks(samples: Samples, backend: str) -> list[str]:
    """What dead features still do.

    samples: as the plugin left them, for a grid of `GRID_WIDTH` and directions of `WIDTH` features.
    """
    if samples.density_features is None and samples.color_features is None:
        return []
    field = _small_field(backend)
    table = field.grid.table
    points = _in_unit_cube(samples.positions.detach())
    harmonics = spherical_harmonics(functional.normalize(points - 0.4, dim=1))
    dead = _dead_entries(field, samples.density_features)
    dead_harmonics = torch.arange(WIDTH) >= (
        WIDTH if samples.color_features is None else samples.color_features
    )
    raw, color = _outputs(field, points, harmonics, samples)
    (grad,) = torch.autograd.grad(
        raw.sum() + color.sum(), table, allow_unused=True, materialize_grads=True
    )
    wrong = (
        [f"{backend} field: dead grid features have a gradient"] if bool(grad[dead].any()) else []
    )
    kept = table.detach().clone()
    with torch.no_grad():
        table[dead] = 1.0
        raw_after, _ = _outputs(field, points, harmonics, samples)
        table.copy_(kept)
        _, color_after = _outputs(
            field, points, torch.where(dead_harmonics, 100.0, harmonics), samples
        )
    if not torch.equal(raw_after, raw.detach()):
        wrong.append(f"{backend} field: dead grid features change the density")
    if not torch.equal(color_after, color.detach()):
        wrong.append(f"{backend} field: dead direction features change the colour")
    return wrong


def _outputs(
    field: RadianceField,
    points: Float[Tensor, "points 3"],
    harmonics: Float[Tensor, "points 16"],
    samples: Samples,
) -> tuple[Float[Tensor, "points out"], Float[Tensor, "points 3"]]:
    raw = field.raw_density(points, samples.density_features)
    return raw, field.color(raw, harmonics, samples.color_features)


def _in_unit_cube(positions: Float[Tensor, "rays samples 3"]) -> Float[Tensor, "points 3"]:
    low, high = positions.amin((0, 1)), positions.amax((0, 1))
    return torch.where(high > low, (positions - low) / (high - low), 0.5).reshape(-1, 3).clamp(0, 1)


def _dead_entries(field: RadianceField, active: float | None) -> Bool[Tensor, "entries features"]:
    """Which numbers of the grid's table belong to features that are not alive."""
    offsets = field.grid.layout.offsets
    dead = torch.zeros(field.grid.table.shape, dtype=torch.bool)
    if active is not None:
        for level, (first, last) in enumerate(pairwise(offsets)):
            dead[int(first) : int(last)] = FEATURES * level + torch.arange(FEATURES) >= active
    return dead


@cache
def _small_field(backend: str) -> RadianceField:
    config = FieldConfig(
        levels=LEVELS,
        base=4,
        finest=16,
        log2_entries=8,
        hidden=8,
        geometry=GEOMETRY,
        backend=backend,
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return RadianceField(config, torch.tensor([[0.0] * 3, [1.0] * 3]), Hooks().layer)
