"""Spans of rays, and samples by length inside of them."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Tensor

from nerfreg.rays.traversal import Runs
from nerfreg.rendering.compositing import integrate
from nerfreg.rendering.sampling import edges_between, importance, merge, stratified
from nerfreg.rendering.spans import MOST_SPANS, Spans

SPACINGS = pytest.mark.parametrize("spacing", ["linear", "disparity"])


def runs_of(*rays: list[tuple[float, float]]) -> Runs:
    """The runs of rays, one list for each."""
    rows = [(ray, *run) for ray, runs in enumerate(rays) for run in runs]
    ray = torch.tensor([row[0] for row in rows], dtype=torch.long)
    t = torch.tensor([row[1:] for row in rows]).view(-1, 2)
    return Runs(ray, t[:, 0], t[:, 1])


def random_runs(
    rays: int, most: int, generator: torch.Generator
) -> list[list[tuple[float, float]]]:
    """For each ray up to `most` runs in [1, 9], which do not touch."""
    made = []
    for _ in range(rays):
        count = int(torch.randint(most + 1, (1,), generator=generator))
        ends = (1 + 8 * torch.rand(2 * count, generator=generator)).sort().values.tolist()
        made.append(list(zip(ends[::2], ends[1::2], strict=True)))
    return made


def spans_of(*rays: list[tuple[float, float]], most: int = MOST_SPANS) -> Spans:
    near, far = torch.full((len(rays),), 1.0), torch.full((len(rays),), 9.0)
    return Spans.of(runs_of(*rays), None, near, far, most)


def real(spans: Spans) -> list[list[tuple[float, float]]]:
    """Those spans of each ray that have a length."""
    return [
        [pair for pair in zip(begin, end, strict=True) if pair[1] > pair[0]]
        for begin, end in zip(spans.begin.tolist(), spans.end.tolist(), strict=True)
    ]


def inside(spans: Spans, t: Tensor) -> Tensor:
    """Which span each distance (R, N) lies in, (R, N, K)."""
    return (t[..., None] >= spans.begin[:, None]) & (t[..., None] <= spans.end[:, None])


# How spans come from runs.


def test_spans_are_the_runs_and_end_without_length() -> None:
    spans = spans_of([(1.5, 2.0), (3.0, 4.0)], [], [(5.0, 6.0)])
    assert spans.begin.tolist() == [[1.5, 3.0], [1.0, 9.0], [5.0, 6.0]]
    assert spans.end.tolist() == [[2.0, 4.0], [9.0, 9.0], [6.0, 6.0]]
    assert spans.near.tolist() == [1.5, 1.0, 5.0] and spans.far.tolist() == [4.0, 9.0, 6.0]


def test_without_runs_rays_are_whole() -> None:
    spans, whole = spans_of([], []), Spans.whole(torch.full((2,), 1.0), torch.full((2,), 9.0))
    assert torch.equal(spans.begin, whole.begin) and torch.equal(spans.end, whole.end)
    assert len(spans_of().near) == 0


def test_a_group_gets_the_union_of_its_rays() -> None:
    # Overlapping, containing, touching and apart; and rays of another group in between.
    runs = runs_of(
        [(1.0, 2.0), (6.0, 7.0)], [(3.0, 4.0)], [(1.5, 3.0), (6.2, 6.4)], [], [(3.0, 5.0)]
    )
    groups = torch.tensor([0, 1, 0, 1, 0])
    near, far = torch.tensor([0.5, 0.5]), torch.tensor([9.0, 9.0])
    spans = Spans.of(runs, groups, near, far)
    assert real(spans) == [[(1.0, 5.0), (6.0, 7.0)], [(3.0, 4.0)]]
    per_ray = spans.per_ray(groups)
    assert per_ray.begin.tolist() == spans.begin[groups].tolist()
    assert spans.per_ray(None) is spans


def test_unions_of_random_runs_against_asking_everywhere() -> None:
    generator = torch.Generator().manual_seed(0)
    rays = random_runs(60, 6, generator)
    groups = torch.randint(12, (60,), generator=generator)
    groups[:12] = torch.arange(12)
    near, far = torch.full((12,), 1.0), torch.full((12,), 9.0)
    spans = Spans.of(runs_of(*rays), groups, near, far, most=100)
    t = torch.linspace(1, 9, 4001)
    found = inside(spans, t.expand(12, -1)).any(dim=2)
    for group in range(12):
        runs = [run for ray in range(60) if groups[ray] == group for run in rays[ray]]
        expected = torch.zeros(len(t), dtype=torch.bool)
        for begin, end in runs:
            expected |= (t >= begin) & (t <= end)
        assert torch.equal(found[group], expected if runs else torch.ones_like(expected))
    # The union of a group does not overlap itself either.
    assert (spans.begin[:, 1:] >= spans.end[:, :-1]).all()


def test_too_many_spans_lose_their_smallest_gaps() -> None:
    # Gaps of 0.5, 0.1, 1, 0.2.
    ray = [(1.0, 2.0), (2.5, 3.0), (3.1, 4.0), (5.0, 5.5), (5.7, 6.0)]
    few = [(2.0, 3.0), (3.01, 4.0)]
    expected = {
        5: ray,
        4: [(1.0, 2.0), (2.5, 4.0), (5.0, 5.5), (5.7, 6.0)],
        3: [(1.0, 2.0), (2.5, 4.0), (5.0, 6.0)],
        2: [(1.0, 4.0), (5.0, 6.0)],
        1: [(1.0, 6.0)],
    }
    for most, spans in expected.items():
        found = real(spans_of(ray, [], few, most=most))
        for pair, wanted in zip(found[0], spans, strict=True):
            assert pair == pytest.approx(wanted)
        assert found[1] == [(1.0, 9.0)]
        # Another ray has enough room for its own, however small its gap.
        assert found[2] == [pytest.approx(pair) for pair in (few if most > 1 else [(2.0, 4.0)])]


def test_filled_random_rays_keep_their_largest_gaps() -> None:
    rays = random_runs(80, 20, torch.Generator().manual_seed(1))
    spans = spans_of(*rays)
    assert spans.begin.shape == (80, MOST_SPANS)
    for found, runs in zip(real(spans), rays, strict=True):
        if not runs:
            continue
        gaps = sorted(b[0] - a[1] for a, b in itertools.pairwise(runs))
        kept = sorted(b[0] - a[1] for a, b in itertools.pairwise(found))
        assert kept == pytest.approx(gaps[-(MOST_SPANS - 1) :], rel=1e-4)
        assert (found[0][0], found[-1][1]) == pytest.approx((runs[0][0], runs[-1][1]))


# Where samples are.


@SPACINGS
@pytest.mark.parametrize("seed", [None, 0, 1])
@pytest.mark.parametrize("count", [8, 9, 16, 64])
def test_every_span_gets_a_sample_and_all_lie_in_spans(
    spacing: str, seed: int | None, count: int
) -> None:
    rays = random_runs(300, MOST_SPANS, torch.Generator().manual_seed(2))
    spans = spans_of(*rays)
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    t = spans.stratified(count, spacing, generator)
    assert t.shape == (300, count) and (t.diff(dim=1) >= 0).all()
    hit = inside(spans, t)
    assert hit.any(dim=2).all()
    assert (hit.any(dim=1) | (spans.end <= spans.begin)).all()


def test_samples_are_spread_by_length() -> None:
    # Lengths 1, 2 and 5 of 8: of 19 samples three are given, and of 16 the spans get 2, 4 and 10.
    spans = spans_of([(1.0, 2.0), (3.0, 5.0), (6.0, 11.0)])
    t = spans.stratified(19)
    hit = inside(spans, t)[0].sum(dim=0)
    assert hit.tolist() == [3, 5, 11]
    # In a span they are even: the midpoints of thirds, fifths and elevenths.
    expected = torch.cat(
        [
            1 + (torch.arange(3) + 0.5) / 3,
            3 + 2 * (torch.arange(5) + 0.5) / 5,
            6 + 5 * (torch.arange(11) + 0.5) / 11,
        ]
    )
    torch.testing.assert_close(t[0], expected)


def test_disparity_spreads_by_differences_of_reciprocals() -> None:
    # Reciprocals run from 1 to 1/2, and from 1/4 to 1/8: four times as long in the first. Of 12
    # samples two are given and ten are divided into 8 and 2.
    spans = spans_of([(1.0, 2.0), (4.0, 8.0)])
    t = spans.stratified(12, "disparity")
    first = 1 / (1 - 0.5 * (torch.arange(9) + 0.5) / 9)
    second = 1 / (0.25 - 0.125 * (torch.arange(3) + 0.5) / 3)
    torch.testing.assert_close(t[0], torch.cat([first, second]))


def test_samples_stay_in_their_strata() -> None:
    spans = spans_of(*[[(1.0, 2.0), (3.0, 5.0)]] * 200)
    generator = torch.Generator().manual_seed(0)
    t = spans.stratified(11, "linear", generator)
    # Strata of the two spans: nine spare samples, a third of which are in the first.
    first, second = (t[:, :4] - 1) * 4, (t[:, 4:] - 3) / 2 * 7
    for part in (first, second):
        assert torch.equal(part.floor().long(), torch.arange(part.shape[1]).expand_as(part))
    assert 0.45 < (first % 1).mean() < 0.55 and (first % 1).std() > 0.25


@SPACINGS
def test_one_span_is_sampled_as_rays_without_gaps(spacing: str) -> None:
    near, far = torch.rand(20), 2 + torch.rand(20)
    whole = Spans.whole(near, far)
    ours = whole.stratified(16, spacing, torch.Generator().manual_seed(0))
    theirs = stratified(near, far, 16, spacing, torch.Generator().manual_seed(0))
    assert torch.equal(ours, theirs)
    assert torch.equal(whole.arranged(ours).edges, edges_between(theirs, near, far))
    more = near[:, None] + (far - near)[:, None] * torch.rand(20, 4)
    places, (t, order) = whole.arranged(ours, more), merge(theirs, more)
    assert torch.equal(places.t, t) and places.order is not None
    assert torch.equal(places.order, order) and places.is_sample is None
    assert torch.equal(places.edges, edges_between(t, near, far))


@SPACINGS
def test_rays_without_length_stay_where_they_are(spacing: str) -> None:
    # Beside a ray with a gap, rays that miss the box, of which nothing may become NaN.
    near, far = torch.tensor([1.0, 3.0, 0.0]), torch.tensor([9.0, 3.0, 0.0])
    spans = Spans.of(runs_of([(1.0, 2.0), (4.0, 6.0)], [], []), None, near, far)
    t = spans.stratified(8, spacing)
    assert (t[1] == 3).all() and (t[2] == 0).all()
    edges = spans.arranged(t).edges
    assert (edges[1] == 3).all() and (edges[2] == 0).all() and edges.isfinite().all()


def test_a_span_of_hardly_any_length_gets_its_sample() -> None:
    # 3/2 samples before it and 1 for it: rounded to even, 1.5 and 2.5 would both be 2.
    tiny = math.nextafter(2.0, 3.0) + 2e-7
    spans = spans_of([(0.0, 1.0), (2.0, tiny), (3.0, 4.0)])
    t = spans.stratified(4)
    assert inside(spans, t).any(dim=1).all()


def test_a_span_at_the_camera_gets_its_sample() -> None:
    # Disparity begins at a thousandth of far, behind the first span.
    spans = spans_of([(0.0, 0.001), (0.012, 9.0)])
    t = spans.stratified(8, "disparity")
    assert inside(spans, t).any(dim=2).all() and t[0, 0] <= 0.001 < 0.012 <= t[0, 1]


# The intervals around samples and gaps.


def arranged_by_hand(runs: list[tuple[float, float]], t: list[float]) -> tuple[list, list]:
    """Distances and borders of one ray, span by span."""
    places, edges = [], [runs[0][0]]
    for number, (begin, end) in enumerate(runs):
        if number:
            places.append((runs[number - 1][1] + begin) / 2)
            edges.append(begin)
        own = sorted(x for x in t if begin <= x <= end)
        places += own
        edges += [(a + b) / 2 for a, b in itertools.pairwise(own)] + [end]
    return places, edges


@SPACINGS
def test_intervals_are_those_found_span_by_span(spacing: str) -> None:
    generator = torch.Generator().manual_seed(3)
    rays = [runs or [(1.0, 9.0)] for runs in random_runs(100, 5, generator)]
    spans = spans_of(*rays)
    coarse = spans.stratified(16, spacing, generator)
    fine = coarse[:, torch.randperm(16, generator=generator)[:7]]
    for samples in ((coarse,), (coarse, fine)):
        places = spans.arranged(*samples)
        assert (places.t.diff(dim=1) >= 0).all() and (places.edges.diff(dim=1) >= 0).all()
        assert (places.edges[:, :-1] <= places.t).all() and (places.t <= places.edges[:, 1:]).all()
        assert places.order is not None and places.is_sample is not None
        given = torch.cat([*samples, spans.gaps], dim=1)
        assert torch.equal(given.gather(1, places.order), places.t)
        assert torch.equal(places.is_sample, places.order < sum(x.shape[1] for x in samples))
        for ray, runs in enumerate(rays):
            t, edges = arranged_by_hand(runs, torch.cat(samples, dim=1)[ray].tolist())
            padding = places.t.shape[1] - len(t)
            end = runs[-1][1]
            assert places.t[ray].tolist() == pytest.approx(t + [end] * padding)
            assert places.edges[ray].tolist() == pytest.approx(edges + [end] * padding)


def test_intervals_of_samples_are_as_long_as_the_ray_is_inside() -> None:
    rays = random_runs(100, MOST_SPANS, torch.Generator().manual_seed(4))
    spans = spans_of(*rays)
    places = spans.arranged(spans.stratified(24, "linear", torch.Generator().manual_seed(0)))
    assert places.is_sample is not None
    lengths = (places.edges.diff(dim=1) * places.is_sample).sum(dim=1)
    expected = [sum(end - begin for begin, end in runs) or 8.0 for runs in rays]
    torch.testing.assert_close(lengths, torch.tensor(expected), rtol=1e-5, atol=1e-5)


def test_importance_never_lands_in_a_gap() -> None:
    rays = [runs or [(2.0, 3.0)] for runs in random_runs(200, 6, torch.Generator().manual_seed(5))]
    spans = spans_of(*rays)
    generator = torch.Generator().manual_seed(0)
    coarse = spans.stratified(16, "linear", generator)
    places = spans.arranged(coarse)
    assert places.is_sample is not None
    for weights in (
        torch.zeros_like(places.t),
        torch.rand(places.t.shape, generator=generator) ** 8,
        # Where gaps have weight, too, they are still left out.
        (~places.is_sample).float(),
    ):
        fine = importance(places.edges, weights, 64, generator, places.is_sample.float())
        # Rounding of the interpolation may put a sample on the border of a gap.
        off = (fine[..., None] - spans.begin[:, None]).clamp_max(0).abs()
        off = off + (fine[..., None] - spans.end[:, None]).clamp_min(0)
        assert off.amin(dim=2).max() < 2e-6
        assert (fine.diff(dim=1) >= 0).all()


# The quadrature, against exact integrals.

PARTS = ((1.0, 1.7, 0.9), (2.1, 2.2, 6.0), (4.0, 7.5, 0.4))
"""Begin, end and density of three slabs; nothing is between them."""


def exact_slabs() -> tuple[float, float]:
    """Opacity and expected distance of the slabs, by integrating s exp(-tau) t in each."""
    light, moment = 1.0, 0.0
    for begin, end, s in PARTS:
        # The integral of s exp(-s (t - begin)) t from begin to end.
        left = math.exp(-s * (end - begin))
        moment += light * (begin + 1 / s - left * (end + 1 / s))
        light *= left
    return 1 - light, moment / (1 - light)


def density_of(t: Tensor) -> Tensor:
    return sum(s * ((t >= a) & (t <= b)).to(t.dtype) for a, b, s in PARTS)


def test_density_that_is_constant_in_each_span_is_integrated_exactly() -> None:
    runs = Runs(
        torch.zeros(3, dtype=torch.long),
        *(torch.tensor([part[i] for part in PARTS], dtype=torch.float64) for i in (0, 1)),
    )
    opacity, depth = exact_slabs()
    near, far = torch.tensor([[0.5], [9.0]], dtype=torch.float64)
    errors = []
    for count in (3, 192, 768, 3072):
        spans = Spans.of(runs, None, near, far)
        places = spans.arranged(spans.stratified(count))
        density = torch.where(places.is_sample, density_of(places.t), 0)
        made = integrate(density, places.edges)
        # However few samples there are: lengths are exact, and so is the light behind each slab.
        assert made.opacity.item() == pytest.approx(opacity, abs=1e-12)
        for begin, end, _ in PARTS:
            last = (places.edges[0, 1:] - end).abs().argmin()
            light = math.exp(-sum(s * max(0.0, min(b, end) - a) for a, b, s in PARTS if a <= begin))
            tau = made.tau[0, : last + 1].sum().item()
            assert math.exp(-tau) == pytest.approx(light, abs=1e-12)
        errors.append(abs(made.depth.item() - depth))
    # Depth takes the middle of each interval for the mean inside it: an error of second order.
    assert errors[-1] < 1e-4 and errors[0] > 1e-3
    # From a few samples on in the thinnest slab, four times as many make it a sixteenth.
    for coarse, fine in itertools.pairwise(errors[1:]):
        assert coarse / fine == pytest.approx(16, rel=0.3)


def test_density_that_varies_in_spans_converges() -> None:
    # sin^2 in each slab: the integral from a to b is (b - a) / 2 - (sin 2b - sin 2a) / 4.
    tau = sum(s * ((b - a) / 2 - (math.sin(2 * b) - math.sin(2 * a)) / 4) for a, b, s in PARTS)
    runs = Runs(
        torch.zeros(3, dtype=torch.long),
        *(torch.tensor([part[i] for part in PARTS], dtype=torch.float64) for i in (0, 1)),
    )
    errors = []
    for count in (32, 128, 512):
        spans = Spans.of(runs, None, *torch.tensor([[0.5], [9.0]], dtype=torch.float64))
        places = spans.arranged(spans.stratified(count))
        density = torch.where(places.is_sample, density_of(places.t) * places.t.sin() ** 2, 0)
        errors.append(abs(integrate(density, places.edges).opacity.item() - 1 + math.exp(-tau)))
    assert errors[0] < 1e-2 and errors[-1] < 1e-5
    assert errors[0] / errors[1] > 10 and errors[1] / errors[2] > 10
