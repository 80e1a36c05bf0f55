"""The stiff and extreme cases that every regularizer meets: what lies along rays, and their cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Int
from torch import Tensor
from torch.nn import functional

from nerfreg.checks.inputs import DTYPES, PIXEL, Inputs, cast
from nerfreg.checks.report import LIMITS, Spot
from nerfreg.hooks import Rays
from nerfreg.numerics import MIN_OPACITY

SIZES = (1, 2, 48)
LARGE = (*SIZES, 4096)
FEW_RAYS = 256
"""From so many samples on, a patch has 2 x 2 pixels and not 4 x 4: exact values take long."""

NEAR, FAR = 2.0, 6.0
ABOVE, BELOW = (-math.log1p(-MIN_OPACITY * (1 + part)) for part in (1e-3, -1e-3))
"""Optical thickness just above and below that of an empty ray."""


@dataclass(frozen=True)
class _Draw:
    """What may lie along R rays: thickness of N intervals, (R, N), and their borders, (N+1)."""

    # The place of each ray on the chequerboard of its patch, 0 or 1.
    side: Int[Tensor, " rays"]
    samples: int
    generator: torch.Generator

    def random(self, columns: int) -> Tensor:
        return torch.rand(len(self.side), columns, generator=self.generator).double()

    def own(self) -> Tensor:
        # A factor of each ray's own, so that no two rays agree.
        return 0.5 + self.random(1)

    def fog(self) -> Tensor:
        logs = 0.5 * torch.randn(len(self.side), self.samples, generator=self.generator).double()
        return 2 / self.samples * logs.exp() * self.own()

    def split(self, thickness: float) -> Tensor:
        share = 0.5 + self.random(self.samples)
        return thickness * share / share.sum(1, keepdim=True)

    def total(self, thickness: float) -> Tensor:
        return self.split(thickness) * self.own()

    def walls(self, *walls: tuple[float, float]) -> Tensor:
        # Each wall has a place from 0 (first sample) to 1 (last), and a thickness.
        tau = torch.zeros(len(self.side), self.samples).double()
        for place, thickness in walls:
            tau[:, round(place * (self.samples - 1))] += (thickness * self.own())[:, 0]
        return tau

    def one_hot(self) -> Tensor:
        where = torch.randint(self.samples, (len(self.side),), generator=self.generator)
        return 1e4 * functional.one_hot(where, self.samples).double()

    def uniform(self) -> Tensor:
        # Weights are 1 / (N + 1) if intervals take 1 / (N + 1), 1 / N, ..., 1 / 2 of what arrives.
        left = torch.arange(self.samples + 1, 1, -1).double()
        return -torch.log1p(-1 / left).expand(len(self.side), -1)

    def ramp(self) -> Tensor:
        return torch.logspace(-6, 6, self.samples).double() * self.own()

    def apart(self) -> Tensor:
        # Black and white pixels of the chequerboard hit different walls.
        far = torch.linspace(0, 1, self.samples) > 0.5
        return torch.where(far == (self.side == 1)[:, None], 5.0, 0.0).double() * self.own()

    def alike(self, difference: float) -> Tensor:
        change = self.random(self.samples)
        return replace(self, side=self.side[:1]).fog() * (1 + difference * change)

    def holes(self) -> Tensor:
        seen = self.random(1) < 0.6
        seen[0] = False
        return torch.where(seen, self.fog(), 0.0)

    def striped(self) -> Tensor:
        thickness = 10 + 20 * self.random(self.samples)
        return torch.where(torch.arange(self.samples) % 2 == 0, thickness, 0.0)

    def cut(self, near: float, far: float) -> Tensor:
        jitter = torch.rand(self.samples - 1, generator=self.generator) - 0.5
        inner = (torch.arange(1, self.samples) + 0.4 * jitter) / self.samples
        unit = torch.cat([torch.zeros(1), inner, torch.ones(1)]).double()
        return near + (far - near) * unit

    def sliver(self, near: float, far: float) -> Tensor:
        start = torch.tensor([0.0, 1e-9], dtype=torch.float64)
        return torch.cat([start, self.cut(1e-9, far)[2:]])

    def half_empty(self, near: float, far: float) -> Tensor:
        return self.cut(near, far)[torch.arange(self.samples + 1) // 2 * 2]

    def collapsed(self, near: float, far: float) -> Tensor:
        return torch.full((self.samples + 1,), near).double()


@dataclass(frozen=True)
class Case:
    """One kind of rays, the same every time it is built.

    Attributes:
        name: For the command line.
        description: For the list of cases.
        thickness: Draws the optical thickness of the intervals.
        ends: Where the rays begin and end.
        cut: Draws the borders of the intervals between.
        regular: Whether losses are smooth there, so that finite differences make sense.
        white: Whether the background is white.
        sizes: Numbers of samples to run it with.
        bounds: Near and far of the scene, where they are not those of the rays.
    """

    name: str
    description: str
    thickness: Callable[[_Draw], Tensor]
    ends: tuple[float, float] = (NEAR, FAR)
    cut: Callable[[_Draw, float, float], Tensor] = _Draw.cut
    regular: bool = False
    white: bool = False
    sizes: tuple[int, ...] = SIZES
    bounds: tuple[float, float] | None = None

    def points(self, dtypes: Sequence[str], samples: int | None) -> Iterator[tuple[Spot, Inputs]]:
        """Yield the rays in each of the precisions that can express them, at each size.

        Half precision is tried at one size. A number of samples takes the place of all sizes.
        """
        for dtype in dtypes:
            usual = self.sizes if dtype in LIMITS else SIZES[-1:]
            for size in (samples,) if samples else usual:
                inputs = cast(self.build(size), DTYPES[dtype])
                if inputs.density.isfinite().all() and inputs.t_edges.isfinite().all():
                    yield Spot(self.name, dtype, size), inputs

    def differentiable(self, spot: Spot) -> bool:
        """Tell whether gradients are compared with finite differences there."""
        return self.regular and spot.dtype == "float64" and spot.samples in SIZES

    def build(self, samples: int) -> Inputs:
        """Return float64 rays: the pixels of a patch, and 2 x 2 more from an unseen pose."""
        side = 2 if samples >= FEW_RAYS else 4
        supervised, count = side * side, side * side + 4
        generator, index = torch.Generator().manual_seed(0), torch.arange(count)
        draw = _Draw((index // side + index) % 2, samples, generator)
        edges, tau = self.cut(draw, *self.ends), self.thickness(draw)
        length = edges.diff()
        # An interval without length has a density all the same.
        density = torch.where(length > 0, tau / torch.where(length > 0, length, 1.0), 1.0)
        near, far = self.bounds or (float(edges[0]), float(edges[-1]))
        place = torch.stack([index % side, index // side], dim=1).double()
        # Rows of an image run down, and y points up.
        across = PIXEL * place * torch.tensor([1.0, -1.0])
        ahead = torch.cat([across, -torch.ones(count, 1).double()], dim=1)
        patch = index[:supervised].view(side, side)
        pairs = [(patch[:, :-1], patch[:, 1:]), (patch[:-1], patch[1:])]
        # A plugin knew nothing of every first ray of three, a part of every second one, and
        # something behind the end of every third.
        part = torch.lerp(edges[0], edges[-1], torch.tensor([0.3, 0.35]).double())
        known = torch.stack([torch.full_like(part, torch.nan), part, part + edges[-1]])
        rays = Rays(
            origins=torch.tensor([0.5, -0.25, 1.0]).double().expand(count, 3) * (far - near),
            directions=functional.normalize(ahead, dim=1),
            near=edges[0].expand(count).clone(),
            far=edges[-1].expand(count).clone(),
            targets=torch.rand(supervised, 3, generator=generator).double(),
            background=torch.ones(count, 3).double() if self.white else None,
            patches=patch[None],
            neighbors=torch.cat([torch.stack(pair, dim=-1).view(-1, 2) for pair in pairs]),
            unseen=index[supervised:],
            unseen_patches=index[supervised:].view(1, 2, 2),
            known_depth=known[index[:supervised] % 3],
            view=torch.where(index < supervised, 0, -1),
            pixel=torch.where((index < supervised)[:, None], place + 0.5, torch.nan),
            unseen_views=torch.zeros(count - supervised, dtype=torch.long),
        )
        return Inputs(
            rays,
            density.expand(count, samples).clone(),
            colors=torch.rand(count, samples, 3, generator=generator).double(),
            t_edges=edges.expand(count, -1).clone(),
            features=torch.randn(count, samples, 4, generator=generator).double(),
            bounds=(near, far),
        )


CASES = (
    Case("fog", "smooth fog, nothing extreme about it", _Draw.fog, regular=True, sizes=LARGE),
    Case("empty", "no density anywhere", lambda d: d.total(0.0)),
    Case("empty_white", "no density anywhere, on white", lambda d: d.total(0.0), white=True),
    Case("thickness_1e-12", "optical thickness 1e-12 in all", lambda d: d.total(1e-12)),
    Case(
        "thickness_1",
        "optical thickness 1 in all, on white",
        lambda d: d.total(1.0),
        regular=True,
        white=True,
    ),
    Case("thickness_1e6", "optical thickness 1e6 in all", lambda d: d.total(1e6)),
    Case("thickness_1e30", "optical thickness 1e30 in all", lambda d: d.total(1e30), sizes=LARGE),
    Case("wall_first", "a wall in the first interval", lambda d: d.walls((0.0, 50.0))),
    Case("wall_middle", "a wall in the middle", lambda d: d.walls((0.5, 50.0))),
    Case("wall_last", "a wall in the last interval", lambda d: d.walls((1.0, 50.0))),
    Case(
        "two_walls",
        "a wall that half the light passes, and one behind it",
        lambda d: d.walls((0.3, 0.7), (0.7, 50.0)),
    ),
    Case(
        "underflow",
        "walls behind a wall that leaves 1e-87 of the light",
        lambda d: d.walls((0.3, 200.0), (0.6, 3.0), (0.9, 3.0)),
    ),
    Case(
        "sliver",
        "an interval of length 1e-9 at the camera holds everything",
        lambda d: d.walls((0.0, 10.0)),
        cut=_Draw.sliver,
    ),
    Case("zero_width", "every second interval has no length", _Draw.fog, cut=_Draw.half_empty),
    Case("tiny_scale", "fog in a scene of 1e-6", _Draw.fog, (2e-6, 6e-6), regular=True),
    Case("huge_scale", "fog in a scene of 1e6", _Draw.fog, (2e6, 6e6), regular=True),
    Case(
        "packed",
        "fog between distances 10000 and 10001",
        _Draw.fog,
        (1e4, 1e4 + 1),
        regular=True,
        sizes=LARGE,
    ),
    Case("near_is_far", "rays of no length", _Draw.fog, cut=_Draw.collapsed, bounds=(NEAR, FAR)),
    Case("one_hot", "all weight in one interval, another for each ray", _Draw.one_hot),
    Case("uniform", "all weights equal", _Draw.uniform, regular=True),
    Case("ramp", "thickness grows from 1e-6 to 1e6 along the ray", _Draw.ramp, sizes=LARGE),
    Case("disagreement", "neighbouring rays have no interval in common", _Draw.apart),
    Case("identical", "neighbouring rays are the same", lambda d: d.alike(0.0)),
    Case("nearly_identical", "neighbouring rays differ by 1e-6", lambda d: d.alike(1e-6)),
    Case("missing_depth", "patches with empty rays in them, on white", _Draw.holes, white=True),
    Case("alternating", "full and empty intervals in turn", _Draw.striped),
    Case("just_visible", "opacity just above that of an empty ray", lambda d: d.split(ABOVE)),
    Case("just_empty", "opacity just below that of a visible ray", lambda d: d.split(BELOW)),
)
