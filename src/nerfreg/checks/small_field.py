"""The small field of a driver, as plugins see it through `step.field`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from nerfreg.field.grid_layout import GridLayout
from nerfreg.field.grid_torch import encode
from nerfreg.field.network import Network
from nerfreg.hooks import TableLevel
from nerfreg.numerics import single
from nerfreg.scenes.scene import SceneInfo

LAYOUT = GridLayout(levels=2, base=2, finest=4, log2_entries=8)
FEATURES = LAYOUT.features
LARGEST = 15.0
"""Bound of the exponent of density."""


@dataclass
class DenseLevel:
    """A level whose vertices all have an entry; implements `TableLevel`.

    Attributes:
        resolution: Cells per side.
        entries: Number of entries, E.
        table: (E, 2) the entries.
        dense: Always true.
    """

    resolution: int
    entries: int
    table: Float[Tensor, "entries 2"]
    dense: bool = True

    def features(self, vertices: Int[Tensor, "*vertices 3"]) -> Float[Tensor, "*vertices 2"]:
        """Return the features of vertices, given as integers from 0 to `resolution`."""
        x, y, z = vertices.unbind(-1)
        side = self.resolution + 1
        return self.table[x + side * (y + side * z)]

    def squared_differences(
        self, vertices: Int[Tensor, "*vertices 3"]
    ) -> Float[Tensor, "*vertices"]:
        """Return the squared differences to the next vertices, over features and axes."""
        own, next_ones = self.features(vertices), torch.eye(3, dtype=vertices.dtype)
        others = [self.features(vertices + one) for one in next_ones]
        return torch.stack([other - own for other in others]).square().sum(dim=(0, -1))


@dataclass(frozen=True)
class SmallField:
    """A grid of two levels and the two networks of a driver; implements `FieldView`.

    Everything runs through plain autograd and has derivatives of any order.

    Attributes:
        table: (E, 2) entries of both levels.
        networks: "density" and "color".
        scene: What is known of the scene.
        more: Number of inputs of the colour network that plugins add.
    """

    table: Float[Tensor, "entries 2"]
    networks: Mapping[str, Network]
    scene: SceneInfo
    more: int = 0

    @property
    def tables(self) -> Sequence[TableLevel]:
        """Both levels."""
        ends = pairwise(map(int, LAYOUT.offsets))
        return tuple(
            DenseLevel(int(cells), last - first, self.table[first:last])
            for cells, (first, last) in zip(LAYOUT.resolutions, ends, strict=True)
        )

    def empty(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Return that nothing is empty, (P,)."""
        return torch.zeros_like(positions[:, 0], dtype=torch.bool)

    def encode(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, "points features"]:
        """Return the encoding of positions, (P, 4)."""
        return encode(self.scene.unit(single(positions)), self.table, LAYOUT, LAYOUT.levels)

    def density(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, " points"]:
        """Return the density per world unit, (P,)."""
        return self.activate(self.raw(positions)[:, 0])

    def density_gradient(
        self, positions: Float[Tensor, "points 3"], create_graph: bool = True
    ) -> Float[Tensor, "points 3"]:
        """Return the gradient of the density by position, (P, 3).

        Args:
            positions: (P, 3) in world units.
            create_graph: Whether the result has gradients itself.
        """
        with torch.enable_grad():
            at = positions if positions.requires_grad else positions.detach().requires_grad_()
            total = self.density(at).sum()
            return torch.autograd.grad(total, at, create_graph=create_graph)[0]

    def color(
        self, positions: Float[Tensor, "points 3"], directions: Float[Tensor, "points 3"]
    ) -> Float[Tensor, "points 3"]:
        """Return the colours in [0, 1] of positions seen along unit directions, (P, 3)."""
        return self.color_of(self.raw(positions)[:, 1:], directions, None)

    def activate(self, raw: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        """Return the density per world unit of raw densities."""
        return torch.exp(raw.clamp(max=LARGEST)) / self.scene.half_box

    def raw(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, "points out"]:
        """Return the outputs of the density network."""
        raw: Tensor = self.networks["density"](self.encode(positions), plain=True)
        return raw

    def color_of(
        self,
        geometry: Float[Tensor, "points geometry"],
        directions: Float[Tensor, "points 3"],
        more: Float[Tensor, "points inputs"] | None,
    ) -> Float[Tensor, "points 3"]:
        """Return the colours of outputs of the density network.

        Args:
            geometry: All of them but the raw density.
            directions: Unit directions.
            more: What plugins add to the input of the colour network; None: zeros.
        """
        more = geometry.new_zeros(len(geometry), self.more) if more is None else more
        inputs = torch.cat([single(directions), geometry, more.to(geometry.dtype)], dim=1)
        return torch.sigmoid(self.networks["color"](inputs, plain=True))


def make_table(dtype: torch.dtype) -> nn.Parameter:
    """Return fresh entries for both levels."""
    entries = torch.randn(LAYOUT.entries, 2, generator=torch.Generator().manual_seed(0))
    return nn.Parameter(entries.to(dtype))
