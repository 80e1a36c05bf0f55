"""The stiff and extreme cases that every regularizer meets: what may lie along a ray, and how it may be cut."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.checks.inputs import Inputs
from nerfreg.hooks import Rays
from nerfreg.numerics import MIN_OPACITY

NEAR, FAR = 2.0, 6.0
SIZES = (1, 2, 48)
MANY = 4096
FEW_RAYS = 256
"""From this many samples on, a batch is one patch of 2 x 2 pixels instead of 4 x 4: exact values take long."""

Thickness = Callable[[Int[Tensor, " rays"], int, torch.Generator], Float[Tensor, "rays samples"]]
"""Given each ray's place on the chequerboard (0 or 1), the number of samples and chance: thickness (R, N), float64."""
Cut = Callable[[int, torch.Generator], Float[Tensor, " edges"]]
"""Given the number of samples: the borders of the intervals (N+1), float64."""


def _spread(near: float, far: float) -> Cut:
    """Intervals of irregular length."""

    def cut(samples: int, chance: torch.Generator) -> Tensor:
        inner = torch.arange(1, samples) + 0.4 * (torch.rand(samples - 1, generator=chance) - 0.5)
        unit = torch.cat([torch.zeros(1), inner / samples, torch.ones(1)]).double()
        return near + (far - near) * unit

    return cut


def _sliver(samples: int, chance: torch.Generator) -> Tensor:
    return torch.cat(
        [torch.tensor([0.0, 1e-9], dtype=torch.float64), _spread(1e-9, FAR)(samples, chance)[2:]]
    )


def _half_empty(samples: int, chance: torch.Generator) -> Tensor:
    """Every second interval has no length."""
    edges = _spread(NEAR, FAR)(samples, chance)
    return edges[torch.arange(samples + 1) // 2 * 2]


def _collapsed(samples: int, chance: torch.Generator) -> Tensor:
    return torch.full((samples + 1,), NEAR).double()


def _fog(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    logs = 0.5 * torch.randn(len(side), samples, generator=chance).double()
    return 2 / samples * logs.exp() * _own(side, chance)


def _total(thickness: float) -> Thickness:
    def profile(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
        share = 0.5 + torch.rand(len(side), samples, generator=chance).double()
        return thickness * share / share.sum(1, keepdim=True) * _own(side, chance)

    return profile


def _walls(*walls: tuple[float, float]) -> Thickness:
    """Each wall: its place from 0 (first sample) to 1 (last), and its thickness."""

    def profile(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
        tau = torch.zeros(len(side), samples).double()
        for place, thickness in walls:
            tau[:, round(place * (samples - 1))] += (thickness * _own(side, chance))[:, 0]
        return tau

    return profile


def _one_hot(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    where = torch.randint(samples, (len(side),), generator=chance)
    return 1e4 * functional.one_hot(where, samples).double()


def _uniform(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    """Weights of 1 / (N + 1) each: the part of what is left is 1 / (N + 1), 1 / N, ..., 1 / 2."""
    left = torch.arange(samples + 1, 1, -1).double()
    return -torch.log1p(-1 / left).expand(len(side), -1)


def _ramp(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    return torch.logspace(-6, 6, samples).double() * _own(side, chance)


def _apart(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    """Black and white pixels of the chequerboard hit different walls."""
    far = torch.linspace(0, 1, samples)[None].expand(len(side), -1) > 0.5
    tau = torch.where(far == (side == 1)[:, None], 5.0, 0.0).double()
    return tau * _own(side, chance)


def _alike(difference: float) -> Thickness:
    def profile(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
        change = torch.rand(len(side), samples, generator=chance).double()
        return _fog(side[:1], samples, chance) * (1 + difference * change)

    return profile


def _holes(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    seen = torch.rand(len(side), 1, generator=chance) < 0.6
    seen[0] = False
    return torch.where(seen, _fog(side, samples, chance), 0.0)


def _striped(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
    thickness = 10 + 20 * torch.rand(len(side), samples, generator=chance).double()
    return torch.where(torch.arange(samples) % 2 == 0, thickness, 0.0)


def _opacity(opacity: float) -> Thickness:
    def profile(side: Tensor, samples: int, chance: torch.Generator) -> Tensor:
        share = 0.5 + torch.rand(len(side), samples, generator=chance).double()
        return -math.log1p(-opacity) * share / share.sum(1, keepdim=True)

    return profile


def _own(side: Tensor, chance: torch.Generator) -> Tensor:
    """(R, 1) a factor of each ray's own, from 0.5 to 1.5, so that no two rays agree."""
    return 0.5 + torch.rand(len(side), 1, generator=chance).double()


USUAL = _spread(NEAR, FAR)


@dataclass(frozen=True)
class Case:
    """One kind of rays, the same every time it is built.

    thickness: optical thickness of the intervals. cut: their borders. regular: whether the loss is smooth there, so
    that finite differences make sense. white: on white background. sizes: numbers of samples to run it with.
    bounds: of the scene, where they are not those of the rays.
    """

    name: str
    description: str
    thickness: Thickness
    cut: Cut = USUAL
    regular: bool = False
    white: bool = False
    sizes: tuple[int, ...] = SIZES
    bounds: tuple[float, float] | None = None

    def build(self, samples: int) -> Inputs:
        """The rays, in float64: the pixels of a patch, and one more of 2 x 2 from an unseen pose."""
        side = 2 if samples >= FEW_RAYS else 4
        supervised = side * side
        count = supervised + 4
        chance = torch.Generator().manual_seed(0)
        index = torch.arange(count)
        edges = self.cut(samples, chance)
        tau = self.thickness((index // side + index) % 2, samples, chance)
        length = edges.diff()
        # An interval without length has a density all the same.
        density = torch.where(length > 0, tau / torch.where(length > 0, length, 1.0), 1.0)
        near, far = self.bounds or (float(edges[0]), float(edges[-1]))
        across = 0.01 * torch.stack([index % side, index // side], dim=1).double()
        ahead = torch.cat([across, -torch.ones(count, 1).double()], dim=1)
        patch = torch.arange(supervised).view(1, side, side)
        rays = Rays(
            origins=torch.tensor([0.5, -0.25, 1.0]).double().expand(count, 3) * (far - near),
            directions=functional.normalize(ahead, dim=1),
            near=edges[0].expand(count).clone(),
            far=edges[-1].expand(count).clone(),
            targets=torch.rand(supervised, 3, generator=chance).double(),
            background=torch.ones(count, 3).double() if self.white else None,
            patches=patch,
            neighbors=torch.cat(
                [
                    torch.stack([patch[0, :, :-1], patch[0, :, 1:]], dim=-1).view(-1, 2),
                    torch.stack([patch[0, :-1], patch[0, 1:]], dim=-1).view(-1, 2),
                ]
            ),
            unseen=index[supervised:],
            unseen_patches=index[supervised:].view(1, 2, 2),
            known_depth=_known_depth(edges, index[:supervised]),
        )
        return Inputs(
            rays=rays,
            density=density.expand(count, samples).clone(),
            colors=torch.rand(count, samples, 3, generator=chance).double(),
            t_edges=edges.expand(count, -1).clone(),
            features=torch.randn(count, samples, 4, generator=chance).double(),
            bounds=(near, far),
        )


def _known_depth(
    edges: Float[Tensor, " edges"], index: Int[Tensor, " rays"]
) -> Float[Tensor, "rays 2"]:
    """Of every first ray of three nothing, of every second a part of it, of every third something behind its end."""
    part = torch.lerp(edges[0], edges[-1], torch.tensor([0.3, 0.35]).double())
    choices = torch.stack([torch.full_like(part, torch.nan), part, part + edges[-1]])
    return choices[index % 3]


LARGE = (*SIZES, MANY)
ABOVE, BELOW = MIN_OPACITY * (1 + 1e-3), MIN_OPACITY * (1 - 1e-3)
CASES = (
    Case("fog", "smooth fog, nothing extreme about it", _fog, regular=True, sizes=LARGE),
    Case("empty", "no density anywhere", _total(0.0)),
    Case("empty_white", "no density anywhere, on white", _total(0.0), white=True),
    Case("thickness_1e-12", "optical thickness 1e-12 in all", _total(1e-12)),
    Case(
        "thickness_1", "optical thickness 1 in all, on white", _total(1.0), regular=True, white=True
    ),
    Case("thickness_1e6", "optical thickness 1e6 in all", _total(1e6)),
    Case("thickness_1e30", "optical thickness 1e30 in all", _total(1e30), sizes=LARGE),
    Case("wall_first", "a wall in the first interval", _walls((0.0, 50.0))),
    Case("wall_middle", "a wall in the middle", _walls((0.5, 50.0))),
    Case("wall_last", "a wall in the last interval", _walls((1.0, 50.0))),
    Case(
        "two_walls",
        "a wall that half the light passes, and one behind it",
        _walls((0.3, 0.7), (0.7, 50.0)),
    ),
    Case(
        "underflow",
        "walls behind a wall that leaves 1e-87 of the light",
        _walls((0.3, 200.0), (0.6, 3.0), (0.9, 3.0)),
    ),
    Case(
        "sliver",
        "an interval of length 1e-9 at the camera holds everything",
        _walls((0.0, 10.0)),
        cut=_sliver,
    ),
    Case("zero_width", "every second interval has no length", _fog, cut=_half_empty),
    Case(
        "tiny_scale",
        "fog in a scene of 1e-6",
        _fog,
        cut=_spread(NEAR * 1e-6, FAR * 1e-6),
        regular=True,
    ),
    Case(
        "huge_scale",
        "fog in a scene of 1e6",
        _fog,
        cut=_spread(NEAR * 1e6, FAR * 1e6),
        regular=True,
    ),
    Case(
        "packed",
        "fog between distances 10000 and 10001",
        _fog,
        _spread(1e4, 1e4 + 1),
        regular=True,
        sizes=LARGE,
    ),
    Case("near_is_far", "rays of no length", _fog, cut=_collapsed, bounds=(NEAR, FAR)),
    Case("one_hot", "all weight in one interval, another for each ray", _one_hot),
    Case("uniform", "all weights equal", _uniform, regular=True),
    Case("ramp", "thickness grows from 1e-6 to 1e6 along the ray", _ramp, sizes=LARGE),
    Case("disagreement", "neighbouring rays have no interval in common", _apart),
    Case("identical", "neighbouring rays are the same", _alike(0.0)),
    Case("nearly_identical", "neighbouring rays differ by 1e-6", _alike(1e-6)),
    Case("missing_depth", "patches with empty rays in them, on white", _holes, white=True),
    Case("alternating", "full and empty intervals in turn", _striped),
    Case("just_visible", "opacity just above that of an empty ray", _opacity(ABOVE)),
    Case("just_empty", "opacity just below that of a visible ray", _opacity(BELOW)),
)
