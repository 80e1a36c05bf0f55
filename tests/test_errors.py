"""Values that no run could use are refused by key, before anything is built."""

from __future__ import annotations

import pytest

from nerfreg.errors import NerfregError
from nerfreg.evaluation import EvalConfig
from nerfreg.field import FieldConfig
from nerfreg.rendering import SamplerConfig
from nerfreg.training import OptimConfig


@pytest.mark.parametrize(
    "config, key, value, message",
    [
        (FieldConfig, "levels", 0, "field.levels=0: must be at least 1"),
        (FieldConfig, "finest", 8, "field.finest=8: must be between 16 and 65536"),
        (FieldConfig, "log2_entries", 40, "field.log2_entries=40: must be between 3 and 26"),
        (FieldConfig, "backend", "cuda", "field.backend=cuda: choose one of auto, numba, torch"),
        (SamplerConfig, "coarse", 0, "sampler.coarse=0: must be at least 1"),
        (SamplerConfig, "spacing", "log", "sampler.spacing=log: choose one of linear, disparity"),
        (OptimConfig, "lr", -1.0, "optim.lr=-1.0: must be between 1e-20 and 1e+06"),
        (OptimConfig, "ema", 1.0, "optim.ema=1.0: must be between 0 and 0.9999"),
        (EvalConfig, "count", 0, "eval.count=0: must be at least 1"),
    ],
)
def test_refused(config: type, key: str, value: object, message: str) -> None:
    with pytest.raises(NerfregError) as error:
        config(**{key: value})
    assert str(error.value) == message


def test_no_fine_samples_are_fine() -> None:
    assert SamplerConfig(fine=0).fine == 0
