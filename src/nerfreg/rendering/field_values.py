"""The field at the samples of each ray, and indexing whose backward pass needs no additions.

PyTorch's `gather` and `index_select` add gradients up at every index, because an index may occur
twice. None does here, so that the backward pass can write each gradient once. This saves 6 ms of a
step of 245 ms for the sorted samples, and 3 % of a step for the picked ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.rendering.spans import Places


class FieldValues(NamedTuple):
    """Values of the field at N samples of each of R rays.

    Attributes:
        density: (R, N) per world unit.
        raw: (K, 1 + geometry) outputs of the density network, K = R * N.
        rows: (R, N) the row of `raw` that belongs to each sample.
    """

    density: Float[Tensor, "rays samples"]
    raw: Float[Tensor, "evaluated out"]
    rows: Int[Tensor, "rays samples"]

    @classmethod
    def scattered(
        cls,
        density: Float[Tensor, " evaluated"],
        raw: Float[Tensor, "evaluated out"],
        places: Int[Tensor, " evaluated"],
        shape: torch.Size,
    ) -> FieldValues:
        """Return values of which some samples have not been evaluated; their density is 0.

        Args:
            density: (K,) densities of those that have been.
            raw: (K, 1 + geometry) outputs of the density network.
            places: (K,) their places among all R * N samples.
            shape: R and N.
        """
        count = len(raw)
        # All others share one more row, of zeros. It may be read many times, but has no gradient.
        raw = torch.cat([raw, raw.new_zeros(1, raw.shape[1])])
        rows = places.new_full((shape.numel(),), count)
        rows[places] = torch.arange(count, device=places.device)
        dense = density.new_zeros(shape.numel()).index_copy(0, places, density)
        return cls(dense.view(shape), raw, rows.view(shape))

    def arranged(self, places: Places) -> FieldValues:
        """Return values of samples in order, with nothing in the gaps between them."""
        if places.order is None:
            return self
        gaps = places.order.shape[1] - self.density.shape[1]
        if not gaps:
            return self.ordered(places.order)
        density = self.density.new_zeros(len(self.density), gaps)
        raw = self.raw.new_zeros(1, self.raw.shape[1])
        nothing = FieldValues(density, raw, density.long())
        return self.followed_by(nothing).ordered(places.order)

    @property
    def raw_density(self) -> Float[Tensor, "rays samples"]:
        """(R, N) outputs of the density network, before the activation.

        It is 0 for samples that have not been evaluated.
        """
        return self.raw[:, 0][self.rows]

    def followed_by(self, other: FieldValues) -> FieldValues:
        """Return both, with the other's samples after these on each ray."""
        # The samples of a ray are then in two parts of `raw`. Their rows are renumbered instead of
        # their outputs being copied into order, since `raw` has many columns.
        return FieldValues(
            torch.cat([self.density, other.density], dim=1),
            torch.cat([self.raw, other.raw]),
            torch.cat([self.rows, other.rows + len(self.raw)], dim=1),
        )

    def ordered(self, order: Int[Tensor, "rays samples"]) -> FieldValues:
        """Return the samples of each ray in another order.

        Args:
            order: (R, N) a permutation of the columns in each row.
        """
        return FieldValues(_permute(self.density, order), self.raw, self.rows.gather(1, order))

    def picked(
        self, ray: Int[Tensor, " picked"], sample: Int[Tensor, " picked"]
    ) -> Float[Tensor, "picked out"]:
        """Return the outputs of the density network, (P, 1 + geometry), at some samples.

        Args:
            ray: (P,) index of the ray.
            sample: (P,) index of the sample on it; no sample may occur twice.
        """
        return _pick(self.raw, self.rows[ray, sample])


class _Permute(torch.autograd.Function):
    """`values.gather(1, order)`, where every row of `order` is a permutation."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, order: Tensor) -> Tensor:
        ctx.save_for_backward(order)
        return values.gather(1, order)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        [order] = ctx.saved_tensors
        # A permutation writes to every element, so that nothing has to be zeroed first.
        return torch.empty_like(grads[0]).scatter_(1, order, grads[0]), None


class _Pick(torch.autograd.Function):
    """`values.index_select(0, rows)`, where no row occurs twice."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        ctx.count = len(values)
        return values.index_select(0, rows)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        [rows] = ctx.saved_tensors
        # The rows that were not picked keep a gradient of 0.
        gradient = grads[0].new_zeros(ctx.count, *grads[0].shape[1:])
        return gradient.index_copy_(0, rows, grads[0]), None


# PyTorch leaves `apply` without types.
_permute: Callable[[Tensor, Tensor], Tensor] = _Permute.apply
_pick: Callable[[Tensor, Tensor], Tensor] = _Pick.apply
