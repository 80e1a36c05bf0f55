from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import pytest

from nerfreg.bench.configured import TINY, set_up, step_at
from nerfreg.cli import main
from nerfreg.config.compose import compose
from nerfreg.errors import NerfregError
from nerfreg.hooks import Needs, Step
from nerfreg.training.trainer import Trainer


def test_a_step_sees_the_share_it_is_taken_at(make: Callable[..., Trainer]) -> None:
    trainer = make("train.steps=30", "train.seconds=0.001")
    seen: list[tuple[int, int, float]] = []

    def needs(step: Step) -> Needs:
        seen.append((step.index, step.total, step.fraction))
        return Needs()

    with patch.object(trainer.hooks, "needs", needs):
        for share in (0.5, 0.5, 0.0, 1.0):
            step_at(trainer, share)
    # The budget in seconds, long spent, plays no part.
    assert seen == [(15, 30, 0.5), (15, 30, 0.5), (0, 30, 0.0), (30, 30, 1.0)]


def test_what_the_command_line_says_wins_over_tiny_sizes() -> None:
    config = compose((*TINY, "train.rays=77"))
    assert (config.train.rays, config.field.levels) == (77, 4)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("train.rais=3",), "unknown key 'train.rais'; did you mean 'train.rays'?"),
        (("+reg=kll",), "unknown plugin or preset 'kll' in reg=kll; did you mean 'kl'?"),
        (("+reg=kl", "+reg=lipschitz"), "reg is chosen 2 times"),
        (("train.steps=null", "train.seconds=5"), "train.steps=null: set it"),
    ],
)
def test_refuses(overrides: tuple[str, ...], message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        set_up(overrides)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refuses_another_device() -> None:
    with pytest.raises(NerfregError, match="device=meta: nerfreg bench measures the CPU"):
        set_up(("device=meta",))


@pytest.mark.parametrize("bench", ["step", "overhead", "scaling"])
def test_errors_make_one_line_and_no_folder(
    bench: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["bench", bench, "scene.sise=3"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("nerfreg: error: unknown key 'scene.sise'") and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
