"""The package grid_tv: neighbouring vertices of the hash grid get similar features."""

from __future__ import annotations

import pytest
import torch

from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")
STEPS = 20


def total_variation(trainer: Trainer) -> list[float]:
    """Of each level, at random vertices, computed from single features."""
    generator = torch.Generator().manual_seed(1)
    axes = torch.eye(3, dtype=torch.long)
    means = []
    for level in trainer.field.grid.tables:
        cells = torch.randint(level.resolution, (5000, 3), generator=generator)
        with torch.no_grad():
            change = level.features(cells[:, None] + axes) - level.features(cells)[:, None]
        means.append(float(change.square().sum(dim=(1, 2)).sqrt().mean()))
    return means


def trained(trainer: Trainer) -> Trainer:
    for _ in range(STEPS):
        trainer.step()
    return trainer


def test_total_variation_falls_in_every_level(make) -> None:
    vanilla = trained(make())
    smooth = trained(make("+reg=grid_tv", "reg.grid_tv.weight=1e-1"))
    assert [level.dense for level in vanilla.field.grid.tables].count(False) >= 1
    for before, after in zip(total_variation(vanilla), total_variation(smooth), strict=True):
        assert after < 0.7 * before
    # It still learns the photographs, beside that.
    assert smooth.step()[0].value < 0.9 * make().step()[0].value


def test_term_is_the_total_variation_of_the_box(make) -> None:
    trainer = make("+reg=grid_tv", "reg.grid_tv.points=20000")
    with torch.no_grad():
        trainer.field.grid.table.normal_()
    [_, term] = trainer.step()
    # Differences of independent features along three axes share the vertex where they begin.
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(20000, 4, 2, generator=generator)
    expected = (features[:, 1:] - features[:, :1]).square().sum(dim=(1, 2)).sqrt().mean()
    assert term.name == "grid_tv"
    assert float(term.value) == pytest.approx(float(expected), rel=0.02)


def test_untrained_grid_of_zeros_has_a_gradient_that_is_finite(make) -> None:
    trainer = make("+reg=grid_tv", "reg.grid_tv.weight=1")
    with torch.no_grad():
        trainer.field.grid.table.zero_()
    trainer.step()
    assert trainer.guard.skipped == 0
    assert trainer.field.grid.table.isfinite().all()


def test_another_encoder_has_no_total_variation(make, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = make("+reg=grid_tv")
    monkeypatch.setattr(
        "nerfreg.rendering.stepped_field.SteppedField.tables", property(lambda _: ())
    )
    assert [term.name for term in trainer.step()] == ["color"]
