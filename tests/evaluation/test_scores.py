from __future__ import annotations

import math

import pytest
import torch

from nerfreg.evaluation.lpips import LPIPS
from nerfreg.evaluation.metrics import average
from nerfreg.evaluation.scores import photograph, score_views
from nerfreg.rendering.views import View


def view_of(rgb: torch.Tensor, depth: torch.Tensor | None = None) -> View:
    ones = torch.ones(rgb.shape[:2])
    return View(rgb, ones if depth is None else depth, ones)


def flat(value: float, side: int = 12) -> torch.Tensor:
    return torch.full((side, side, 3), value)


def ramp(seed: int, height: int = 40, width: int = 36) -> torch.Tensor:
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def test_psnr_is_the_mean_over_images_not_of_the_mean_error(make_scene):
    # errors 0.1 and 0.01 are 20 and 40 dB, mean 30; the mean MSE 0.00505 would be 22.97
    scene = make_scene(images=[flat(0.5), flat(0.5)])
    scores = score_views(scene, [0, 1], lambda view: view_of(flat((0.6, 0.51)[view])), None)
    assert scores.psnr == pytest.approx(30.0, abs=1e-3)
    assert [v.psnr for v in scores.views] == pytest.approx([20.0, 40.0], abs=1e-3)


def test_average_is_made_of_the_means(make_scene):
    # any fixed network will do for LPIPS here: what counts is how the means are joined
    convolutions = tuple(
        (torch.full((2, 3 if i == 0 else 2, size, size), 0.1), torch.tensor([0.0, 1.0]))
        for i, size in enumerate((11, 5, 3, 3, 3))
    )
    lpips = LPIPS(convolutions, tuple(torch.ones(1, 2, 1, 1) for _ in range(5)))
    images = [ramp(0), ramp(1)]
    scene = make_scene(images=images)
    scores = score_views(
        scene, [0, 1], lambda view: view_of(images[view] * (0.5, 0.9)[view]), lpips
    )
    each = [average(v.psnr, v.ssim, v.lpips) for v in scores.views]
    assert scores.average == pytest.approx(average(scores.psnr, scores.ssim, scores.lpips))
    assert scores.average != pytest.approx(sum(each) / 2, rel=1e-3)
    assert scores.lpips == pytest.approx(sum(v.lpips for v in scores.views) / 2)


def test_alpha_is_composited_on_the_background(make_scene):
    # colour 0.2, alpha 0.25 on white: 0.2 * 0.25 + 0.75 = 0.8
    rgba = torch.cat([flat(0.2), torch.full((12, 12, 1), 0.25)], dim=-1)
    scene = make_scene(images=[rgba], background=torch.ones(3))
    assert torch.allclose(photograph(scene, 0), flat(0.8))
    scores = score_views(scene, [0], lambda view: view_of(flat(0.8)), None)
    assert scores.psnr > 100


def test_the_background_may_have_a_colour(make_scene):
    rgba = torch.cat([flat(0.2), torch.zeros(12, 12, 1)], dim=-1)
    scene = make_scene(images=[rgba], background=torch.tensor([1.0, 0.5, 0.0]))
    assert torch.equal(photograph(scene, 0)[3, 4], torch.tensor([1.0, 0.5, 0.0]))


def test_predictions_are_clipped_before_they_are_scored(make_scene):
    # 1.5 against 0.9 counts as 1.0 against 0.9: 20 dB; a clip of the difference would not
    scene = make_scene(images=[flat(0.9)])
    assert score_views(scene, [0], lambda v: view_of(flat(1.5)), None).psnr == pytest.approx(
        20.0, abs=1e-3
    )


def test_depth_is_compared_where_it_is_known(make_scene):
    truth = torch.full((12, 12), math.inf)
    truth[0, 0] = 2.0
    scene = make_scene(images=[flat(0.5)], depths=[truth])
    depth = torch.full((12, 12), 3.0)
    assert score_views(scene, [0], lambda v: view_of(flat(0.5), depth), None).depth_rmse == 1.0


def test_views_without_a_surface_do_not_count_in_the_depth_error(make_scene):
    sky = torch.full((12, 12), math.inf)
    scene = make_scene(images=[flat(0.5)] * 2, depths=[sky, torch.full((12, 12), 5.0)])
    scores = score_views(scene, [0, 1], lambda v: view_of(flat(0.5)), None)
    assert [v.depth_rmse for v in scores.views] == [None, 4.0]
    assert scores.depth_rmse == 4.0


def test_what_is_unknown_is_none(make_scene):
    scores = score_views(make_scene(images=[flat(0.5)]), [0], lambda v: view_of(flat(0.5)), None)
    assert scores.record() == {
        "psnr": math.inf,
        "ssim": pytest.approx(1.0, abs=1e-6),
        "lpips": None,
        "average": None,
        "depth_rmse": None,
    }


def test_the_order_of_views_changes_nothing_not_even_the_last_bit(make_scene):
    images = [ramp(i) for i in range(5)]
    scene = make_scene(images=images, depths=[image[..., 0] + 1 for image in images])

    def render(view: int) -> View:
        return view_of(images[view] * 0.9, images[view][..., 1] + 1)

    orders = ([0, 1, 2, 3, 4], [3, 1, 4, 0, 2], [4, 3, 2, 1, 0])
    records = [score_views(scene, order, render, None).record() for order in orders]
    assert records[0] == records[1] == records[2]


def test_a_shifted_rendering_scores_worse(make_scene):
    image = ramp(0)
    scene = make_scene(images=[image])
    exact = score_views(scene, [0], lambda v: view_of(image * 0.99), None)
    shifted = score_views(scene, [0], lambda v: view_of(image.roll(1, dims=0)), None)
    assert shifted.psnr < exact.psnr
    assert shifted.ssim < exact.ssim


def test_strided_renderings_are_compared_with_the_same_pixels(make_scene):
    image, depth = ramp(0), ramp(1)[..., 0] + 1
    scene = make_scene(images=[image], depths=[depth])
    scores = score_views(
        scene, [0], lambda v: view_of(image[::3, ::3], depth[::3, ::3] + 0.5), None, stride=3
    )
    assert scores.psnr == math.inf
    assert scores.depth_rmse == pytest.approx(0.5, abs=1e-6)
    assert scores.ssim is None  # an image of another scale: not comparable


def test_a_rendering_of_another_size_is_refused(make_scene):
    scene = make_scene(images=[ramp(0)])
    with pytest.raises(ValueError, match=r"view 0 .*\(20, 36, 3\).*\(40, 36, 3\)"):
        score_views(scene, [0], lambda v: view_of(ramp(0)[:20]), None)


def test_nothing_is_changed_in_place(make_scene):
    rgba = torch.rand(12, 12, 4)
    scene = make_scene(images=[rgba], depths=[torch.ones(12, 12)], background=torch.ones(3))
    rendered = view_of(flat(0.5) * 3)
    before = rgba.clone()
    score_views(scene, [0], lambda v: rendered, None)
    assert torch.equal(rgba, before)
    assert torch.equal(rendered.rgb, flat(1.5))
    assert torch.equal(scene.background, torch.ones(3))
