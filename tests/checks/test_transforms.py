"""Dead features have no influence on the core's field; if they had, it would be found."""

from __future__ import annotations

import pytest
import torch

from nerfreg.checks.transforms import BACKENDS, wrong_masks
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Samples


def samples(density: float | None, color: float | None) -> Samples:
    positions = torch.rand(3, 5, 3, generator=torch.Generator().manual_seed(0))
    return Samples(positions, torch.ones(3, 3), torch.ones(3, 5), density, color, 8, 16)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("density", "color"), [(None, None), (0.0, 0.0), (3.0, 4.0), (2.5, 0.5), (8.0, 16.0)]
)
def test_dead_features_have_no_influence(backend, density, color):
    assert wrong_masks(samples(density, color), backend) == []


@pytest.mark.parametrize("backend", BACKENDS)
def test_field_that_does_not_mask(backend, monkeypatch):
    raw_density, color = RadianceField.raw_density, RadianceField.color
    monkeypatch.setattr(
        RadianceField, "raw_density", lambda self, positions, active: raw_density(self, positions)
    )
    monkeypatch.setattr(
        RadianceField, "color", lambda self, raw, harmonics, active: color(self, raw, harmonics)
    )
    assert wrong_masks(samples(3.0, 4.0), backend) == [
        f"{backend} field: dead grid features have a gradient",
        f"{backend} field: dead grid features change the density",
        f"{backend} field: dead direction features change the colour",
    ]
