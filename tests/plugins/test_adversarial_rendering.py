from __future__ import annotations

import torch
from nerfreg_plugins.adversarial import Adversarial

from nerfreg import Rays, Step
from nerfreg.field import FieldConfig
from nerfreg.field.radiance_field import RadianceField
from nerfreg.registry import Hooks
from nerfreg.rendering import SamplerConfig
from nerfreg.rendering.renderer import Renderer


def test_through_the_real_renderer():
    """The core renders again at the same samples; the error grows; the main pass is unchanged."""
    torch.manual_seed(0)
    plugin = Adversarial(
        positions=1e-3, directions=1e-2, t=1e-3, features=1e-4, sigma=1e-2, rgb=1e-2
    )
    hooks = Hooks({"adversarial": plugin})
    box = torch.tensor([[-4.0] * 3, [4.0] * 3])
    config = FieldConfig(levels=2, base=4, finest=8, log2_entries=8, backend="torch")
    renderer = Renderer(
        RadianceField(config, box, hooks.layer), SamplerConfig(coarse=8, fine=8), hooks
    )
    directions = torch.nn.functional.normalize(torch.randn(6, 3), dim=-1)
    rays = Rays(
        torch.zeros(6, 3),
        directions,
        torch.full((6,), 0.1),
        torch.full((6,), 4.0),
        torch.rand(5, 3),
    )
    step = Step(
        0,
        10,
        0.0,
        torch.Generator().manual_seed(0),
        (0.1, 4.0),
        renderer,
    )
    rendering = renderer.render(rays, step)
    clean = (rendering.rgb[:5] - rays.targets).square().mean()
    term = plugin.nerfreg_loss(rendering, step)["adversarial"]
    assert clean < term < clean + 0.1
    assert not step.rerender(rendering, frozen=True).rgb.requires_grad, (
        "only weights would get a gradient here"
    )
    term.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in renderer.field.parameters())
    torch.testing.assert_close(step.rerender(rendering).rgb, rendering.rgb)
