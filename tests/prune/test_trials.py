from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg import Regularizer
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.field.fit import fitted
from nerfreg.prune.plan import Trial
from nerfreg.prune.trials import Trials, in_share, usual_time
from nerfreg.registry import Hooks

SMALL = [
    "field.levels=2", "field.log2_entries=8", "sampler.coarse=8", "sampler.fine=8", "train.rays=32",
    "train.quiet=true", "eval.lpips=false", "sampler.skip_resolution=8",
]  # fmt: skip


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """NeRF-Synthetic: three training frames of 32 x 32 pixels on a circle, and no test images."""
    generator = np.random.default_rng(0)
    for part, count in (("train", 3), ("test", 2)):
        frames = []
        for index in range(count):
            turn = 2 * math.pi * index / count
            sine, cosine = math.sin(turn), math.cos(turn)
            pose = [
                [cosine, 0, sine, 3 * sine],
                [0, 1, 0, 0],
                [-sine, 0, cosine, 3 * cosine],
                [0, 0, 0, 1],
            ]
            frames.append({"file_path": f"./{part}/r_{index}", "transform_matrix": pose})
        (tmp_path / f"transforms_{part}.json").write_text(
            json.dumps({"camera_angle_x": 0.7, "frames": frames})
        )
    (tmp_path / "train").mkdir()
    for index in range(3):
        iio.imwrite(
            tmp_path / "train" / f"r_{index}.png",
            generator.integers(0, 256, (32, 32, 4), dtype=np.uint8),
        )
    return tmp_path


def test_no_test_image_is_read(photographs: Path, compose: Callable[..., Config]) -> None:
    scene = [
        "scene=blender",
        f"scene.path={photographs}",
        "scene.split=null",
        "scene.views=null",
        "scene.factor=1",
    ]
    config = compose(*scene, *SMALL, "+reg=distortion", "train.steps=4", "scene.held_out=[0]")
    trials = Trials(config, 2)
    assert len(trials.scene.train) + len(trials.scene.test) == 3
    for held_out in ((0,), (1,), (2,), (0, 2)):
        measured = trials(Trial(("distortion",), held_out, 0, 2))
        assert measured.psnr is not None and 0 < measured.psnr < 40
        assert measured.average is None and measured.failure is None
        assert 0 < measured.step_seconds < measured.seconds


def test_the_same_trial_gives_the_same_score(compose: Callable[..., Config]) -> None:
    words = (
        "scene.size=16",
        "scene.views=3",
        *SMALL,
        "+reg=[distortion,lipschitz]",
        "scene.held_out=[0]",
    )
    words += ("reg.distortion.weight=0.1",)
    trials = Trials(compose(*words, "train.steps=10", "train.threads=1"), 1)

    def score(names: tuple[str, ...], held_out: tuple[int, ...], seed: int) -> float | None:
        return trials(Trial(names, held_out, seed, 5)).psnr

    first = score(("lipschitz",), (1,), 0)
    others = [
        score(("distortion", "lipschitz"), (1,), 0),
        score(("lipschitz",), (2,), 0),
        score(("lipschitz",), (1,), 1),
    ]
    assert score(("lipschitz",), (1,), 0) == first and first not in others


def test_a_step_bears_its_share_of_what_comes_before_the_first(
    compose: Callable[..., Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Hooks, "known_depth", lambda hooks, photographs: time.sleep(0.4))
    words = ("scene.size=8", "scene.views=3", *SMALL, "scene.held_out=[0]", "train.steps=4")
    measured = Trials(compose(*words), 1)(Trial((), (1,), 0, 2))
    # of a whole run of 4 steps, not of this one of 2
    assert measured.step_seconds > 0.1
    assert measured.seconds > 0.4


def test_a_trial_trains_the_grid_that_a_run_would(compose: Callable[..., Config]) -> None:
    words = (
        "scene.size=8",
        "scene.views=3",
        "scene.held_out=[0]",
        "train.steps=4",
        "field.fit=true",
    )
    config = compose(*words, "train.quiet=true")
    trials = Trials(config, 2)
    trainer = trials._trainer(Trial((), (0,), 0, 2))
    expected = fitted(config.field, trials.scene)
    assert trainer.field.grid.layout.levels == expected.levels < config.field.levels


def test_a_single_view_cannot_be_held_out(compose: Callable[..., Config]) -> None:
    config = compose("scene.size=8", "scene.views=1", "+reg=lipschitz", "scene.held_out=[0]")
    with pytest.raises(NerfregError, match="the scene has 1 training view; prune judges on"):
        Trials(config, 2)


@pytest.mark.parametrize(
    ("window", "moved"),
    [
        ((0.1, 1.0), (0.1, 1.0)),
        ((1000, 1.0), (250, 1.0)),
        ((1000, 8000), (250, 2000)),
        ((1, 2), (0, 1)),  # it stays a window
        ((0.5, 2000), (0.5, 500)),
    ],
)
def test_windows_in_steps_keep_their_share(
    window: tuple[int | float, int | float], moved: tuple[int | float, int | float]
) -> None:
    plugin = in_share(Regularizer(0.3, *window), 1000, 4000)
    assert (plugin.weight, plugin.start, plugin.end) == (0.3, *moved)
    assert [type(plugin.start), type(plugin.end)] == [type(value) for value in moved]


def test_usual_time() -> None:
    # Twenty steps, two in each tenth: 10 ms in the first half, 30 ms in the second.
    clock = [0.0]
    for step in range(20):
        clock.append(clock[-1] + (0.01 if step < 10 else 0.03))
    assert usual_time(clock) == pytest.approx(0.02)
    # 30 steps of 10 ms, each tenth with one that was interrupted for a second.
    clock = [0.0]
    for step in range(30):
        clock.append(clock[-1] + (1.0 if step % 3 == 1 else 0.01))
    assert usual_time(clock) == pytest.approx(0.01)
    assert usual_time([0.0, 0.5]) == 0.5
    assert usual_time([0.0]) == 0.0
