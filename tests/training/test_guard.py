"""A step that is not finite changes nothing; three in a row end the run and keep its weights."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from nerfreg.cli import main
from nerfreg.config.schema import Config
from nerfreg.errors import NonFiniteError
from nerfreg.field import RadianceField
from nerfreg.registry import Hooks
from nerfreg.runs.replay import replay
from nerfreg.scenes import load_scene
from nerfreg.training.checkpoint import load_checkpoint
from nerfreg.training.faults import usable
from nerfreg.training.guard import Guard
from nerfreg.training.trainer import Trainer

SMALL = [
    "scene.size=16", "scene.views=3", "scene.test_views=1", "field.levels=4", "field.finest=64",
    "sampler.coarse=8", "sampler.fine=8", "field.log2_entries=10", "train.rays=64",
    "train.steps=10", "train.quiet=true", "eval.count=1", "eval.lpips=false", "hydra.run.dir=run",
]  # fmt: skip
WAYS = pytest.mark.parametrize(
    "way, what",
    [
        ("value", "value of faulty"),
        ("gradient", "gradient of faulty"),
        ("square", "gradient of faulty"),
    ],
)


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def state(trainer: Trainer) -> list[Tensor]:
    """Copies of all that a step may change: weights, Adam's moments and counts, averages."""
    adam = [value for moments in trainer.optimizer.state.values() for value in moments.values()]
    return [
        t.detach().clone() for t in (*trainer.field.parameters(), *adam, *trainer.average.averages)
    ]


def same(before: list[Tensor], after: list[Tensor]) -> bool:
    return len(before) == len(after) and all(
        torch.equal(a, b) for a, b in zip(before, after, strict=True)
    )


@WAYS
def test_a_step_that_is_not_finite_changes_nothing(
    make: Callable[..., Trainer], way: str, what: str
) -> None:
    lines: list[str] = []
    trainer = make(
        "+reg=[faulty,lipschitz]",
        "reg.faulty.steps=[3]",
        f"reg.faulty.way={way}",
        guard=Guard(None, lines.append),
    )
    for _ in range(3):
        trainer.step()
    before, updates = state(trainer), trainer.average.updates
    trainer.step()
    assert same(before, state(trainer)) and trainer.average.updates == updates
    assert (trainer.guard.skipped, trainer.budget.step) == (1, 4)
    [line] = lines
    assert line.startswith(f"step 3 left out: {what} is not finite (")
    for _ in range(3):
        trainer.step()
    assert trainer.guard.skipped == 1 and len(lines) == 1
    after = state(trainer)
    assert not same(before, after) and all(t.isfinite().all() for t in after)


def test_the_first_step_of_all_may_be_the_one(make: Callable[..., Trainer]) -> None:
    trainer = make("+reg=faulty", "reg.faulty.steps=[0]")
    before = [p.detach().clone() for p in trainer.field.parameters()]
    trainer.step()
    assert (
        same(before, [p.detach() for p in trainer.field.parameters()])
        and not trainer.optimizer.state
    )


def test_looking_for_the_fault_leaves_the_rng_state(make: Callable[..., Trainer]) -> None:
    # Step 2 is left out in one run and trained in the other; both draw the same rays and samples
    # in step 3.
    runs = [make("+reg=faulty", f"reg.faulty.steps=[{step}]") for step in (2, 39)]
    for trainer in runs:
        for _ in range(3):
            trainer.step()
    left_out, trained = runs
    assert torch.equal(left_out.generator.get_state(), trained.generator.get_state())
    assert left_out.renderer.points == trained.renderer.points


def test_three_in_a_row_end_it_and_two_do_not(make: Callable[..., Trainer]) -> None:
    trainer = make(
        "+reg=faulty", "reg.faulty.steps=[1,2,4,5,7,8,9]", guard=Guard(None, lambda line: None)
    )
    for _ in range(9):
        trainer.step()
    assert trainer.guard.skipped == 6
    before = state(trainer)
    with pytest.raises(NonFiniteError, match="step 9 left out: value of faulty is not finite"):
        trainer.step()
    assert same(before, state(trainer)) and trainer.budget.step == 10


@pytest.mark.parametrize(
    "gradient, wanted",
    [
        ([1.0, -2.0], True),
        ([1.0, torch.nan], False),
        ([torch.inf, -torch.inf], False),
        # 1e38 is the square of 1e19; the largest float32 is 3.4e38
        ([1e19, 1e19, 1e19, 1e19], True),  # each square is finite, their sum 4e38 is not
        ([1e19, 1e20], False),  # 1e40
        ([1e-30, 0.0], True),
        ([], True),
    ],
)
def test_gradients_that_adam_can_take(gradient: list[float], wanted: bool) -> None:
    parameter = nn.Parameter(torch.zeros(len(gradient)))
    parameter.grad = torch.tensor(gradient)
    assert usable(torch.tensor(1.0), [nn.Parameter(torch.zeros(2)), parameter]) is wanted
    assert not usable(torch.tensor(torch.nan), [parameter])


def test_the_gradient_of_a_matrix_is_looked_at_whatever_its_strides() -> None:
    parameter = nn.Parameter(torch.zeros(3, 2).t())
    parameter.grad = torch.zeros(3, 2).t()
    assert usable(torch.tensor(1.0), [parameter])
    parameter.grad[1, 2] = torch.inf
    assert not usable(torch.tensor(1.0), [parameter])


def test_a_run_that_ends_early_leaves_the_weights_of_before(
    compose: Callable[..., Config], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["+reg=[faulty,kl]", "reg.faulty.steps=[4,5,6]", *SMALL]
    assert main(["train", *words]) == 3
    error = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in error[:2]] == [
        "step 4 left out",
        "step 5 left out",
    ]  # quiet or not
    assert error[2].startswith(
        "nerfreg: error: step 6 left out: value of faulty is not finite (nan); this is the 3rd"
    )
    assert error[2].endswith(
        "see nerfreg check --replay "
        + str(Path("run", "nonfinite", "step_000006.safetensors").resolve())
    )

    config = compose(*words[:-1])
    scene = load_scene(config.scene)
    trainer = Trainer(
        scene,
        Hooks(config.reg),
        config.field,
        config.sampler,
        config.optim,
        config.train,
        config.seed,
    )
    for _ in range(4):
        trainer.step()
    field = RadianceField(config.field, scene.box, Hooks(config.reg).layer)
    saved = load_checkpoint(Path("run"), field)
    assert (saved.step, saved.skipped_steps) == (7, 3)
    with trainer.average.applied():
        assert same(list(trainer.field.parameters()), list(field.parameters()))
    assert not Path("run", "results.json").exists()


def test_steps_left_out_are_counted_in_the_results() -> None:
    assert main(["train", "+reg=faulty", "reg.faulty.steps=[1,3,4,6,8]", *SMALL]) == 0
    results = json.loads(Path("run", "results.json").read_text())
    assert (results["skipped_steps"], results["step"]) == (5, 10)
    assert (
        json.loads(Path("run", "metrics.jsonl").read_text().splitlines()[-1])["skipped_steps"] == 5
    )
    # three of them are kept, the latest
    kept = sorted(path.name for path in Path("run", "nonfinite").iterdir())
    assert kept == [f"step_00000{step}.safetensors" for step in (4, 6, 8)]
    # Scoring the checkpoint again keeps their number, and the next run in the folder removes the
    # files.
    assert main(["evaluate", "run"]) == 0
    assert json.loads(Path("run", "results.json").read_text())["skipped_steps"] == 5
    assert main(["train", *SMALL]) == 0
    assert json.loads(Path("run", "results.json").read_text())["skipped_steps"] == 0
    assert not list(Path("run", "nonfinite").iterdir())


@WAYS
def test_a_step_replays_far_from_its_run_until_the_plugin_is_repaired(
    way: str,
    what: str,
    faulty: type,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [
        "+reg=[faulty,combinerf]",
        "reg.faulty.steps=[5]",
        f"reg.faulty.way={way}",
        "reg.faulty.weight=0.5",
    ]
    assert main(["train", *words, *SMALL]) == 0
    file = Path("elsewhere.safetensors")
    shutil.move(Path("run", "nonfinite", "step_000005.safetensors"), file)
    shutil.rmtree("run")
    capsys.readouterr()
    assert replay(file) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("step 5 of 10, 64 rays") and lines[1].strip() == what
    rows = {line.split()[0]: line.split()[1:] for line in lines[3:8]}
    assert rows["faulty"][0] == "0.5"
    assert rows["faulty"][2:] == (["not", "checked"] if way == "value" else ["NOT", "FINITE"])
    assert rows["color"][2:] == rows["kl"][2:] == ["finite"]
    if way == "gradient":  # the root was taken of the opacity of ray 7
        samples = lines[next(i for i, line in enumerate(lines) if line.startswith("ray ")) + 1 :]
        assert samples and {line.split()[0] for line in samples} == {"7"}
    monkeypatch.setattr(faulty, "repaired", True)
    assert replay(file) == 0
    assert "everything is finite now" in capsys.readouterr().out
