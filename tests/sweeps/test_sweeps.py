"""A sweep from beginning to end, of jobs that take no time."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nerfreg.cli import launch, main
from nerfreg.config.naming import overrides_name
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.sweeps.folders import BusyError, claimed
from nerfreg.sweeps.jobs import _fair_threads
from nerfreg.sweeps.journal import JobEntry, JobState
from nerfreg.sweeps.plan import Plan
from nerfreg.sweeps.summary import in_numbers

Job = Callable[[Config, Path], None]


class Jobs:
    """Stands for training; `done` has the seeds in the order in which they were asked for."""

    def __init__(self) -> None:
        self.done: list[int] = []
        self.failing: dict[int, BaseException] = {}

    def __call__(self, config: Config, folder: Path) -> None:
        self.done.append(config.seed)
        (folder / "metrics.jsonl").touch()
        if config.seed in self.failing:
            raise self.failing[config.seed]
        record = {
            "psnr": 20.0 + config.seed,
            "average": 0.1,
            "held_out": config.scene.held_out is not None,
        }
        (folder / "results.json").write_text(json.dumps(record))


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Jobs:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.setattr(sys, "argv", ["nerfreg"])
    jobs = Jobs()
    monkeypatch.setattr(launch, "train", jobs)
    return jobs


def folders(root: Path = Path("multirun/procedural")) -> list[str]:
    return sorted(path.name for path in root.iterdir())


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        (["+reg=combinerf", "seed=1"], "reg=combinerf,seed=1"),
        (["train.rays=64", "seed=1", "reg.kl.weight=1e-4", "+reg=[kl,lipschitz]"],
         "reg=kl+lipschitz,reg.kl.weight=1e-4,seed=1,train.rays=64"),
        (["name=mine", "train.quiet=true", "seed=3"], "seed=3"),
        ([], ""),
    ],
)  # fmt: skip
def test_names_without_a_hash_say_everything(overrides: list[str], name: str) -> None:
    assert overrides_name(overrides) == name
    assert overrides_name(overrides[::-1]) == name


def test_names_that_cannot_say_everything_differ_by_a_hash() -> None:
    paths = [overrides_name([f"scene.path={path}"]) for path in ("a/fern", "b/fern", "/a/fern")]
    assert all(name.startswith("scene.path=fern_") for name in paths)
    long = [overrides_name([f"scene.path={'x' * 200}", f"seed={seed}"]) for seed in range(3)]
    signs = [overrides_name([f"name_={sign}"]) for sign in ("a b", "a:b", "a-b")]
    assert all(len(set(names)) == 3 for names in (paths, long, signs))
    assert max(map(len, long)) <= 109  # 100, an underscore, 8 digits


def test_failing_job_is_recorded_and_the_others_are_done(
    jobs: Jobs, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs.failing = {
        1: NerfregError("no such thing"),
        2: ZeroDivisionError("by zero"),
        3: SystemExit(7),
    }
    assert main(["train", "-m", "seed=0,1,2,3,4"]) == 1
    assert jobs.done == [0, 1, 2, 3, 4]
    failures = [
        json.loads(Path(f"multirun/procedural/seed={i}/failed.json").read_text()) for i in (1, 2, 3)
    ]
    assert [(f["error"], f["message"]) for f in failures] == [
        ("NerfregError", "no such thing"), ("ZeroDivisionError", "by zero"), ("SystemExit", "7")
    ]  # fmt: skip
    assert (
        failures[1]["overrides"] == ["seed=2"] and "raise self.failing" in failures[1]["traceback"]
    )
    assert set(failures[0]) == {"error", "message", "overrides", "traceback", "time"}
    shown = capsys.readouterr()
    *_, last = shown.out.splitlines()
    assert last == "5 jobs: 2 done, 0 skipped, 3 failed"
    assert "multirun/procedural/seed=2: ZeroDivisionError: by zero" in shown.out.splitlines()
    assert shown.err.splitlines()[1:3] == [
        "[2/5] seed=1",
        "[2/5] failed: NerfregError: no such thing",
    ]
    assert not [*Path("multirun").glob(".*")]  # The journal was read and removed.


def test_starting_again_redoes_what_is_not_complete(
    jobs: Jobs, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs.failing = {1: ZeroDivisionError()}
    assert main(["train", "-m", "seed=0,1"]) == 1
    failed = Path("multirun/procedural/seed=1")
    (failed / "nonfinite").mkdir()
    (failed / "notes.txt").touch()
    jobs.failing.clear()
    capsys.readouterr()
    # A new seed joins the old ones, and a quiet run counts as the same run.
    assert main(["train", "-m", "seed=0,1,2", "train.quiet=true"]) == 0
    assert jobs.done == [0, 1, 1, 2]
    assert sorted(path.name for path in failed.iterdir()) == [
        ".hydra",
        "metrics.jsonl",
        "notes.txt",
        "results.json",
    ]
    shown = capsys.readouterr()
    assert shown.err.splitlines() == [
        "[1/3] seed=0: skipped, complete",
        "[2/3] seed=1",
        "[3/3] seed=2",
    ]
    rows = [line.split("\t") for line in shown.out.splitlines()]
    assert rows[0] == ["", "state", "psnr", "average", "job", "folder"]
    assert rows[1] == ["1", "skipped", "20.00", "0.1000", "seed=0", "multirun/procedural/seed=0"]
    assert rows[-1] == ["3 jobs: 2 done, 1 skipped, 0 failed"]


def test_two_configurations_never_share_a_folder(jobs: Jobs) -> None:
    preset = Path("conf/reg/mine.yaml")
    preset.parent.mkdir(parents=True)
    for weight in (0.25, 0.5, 0.25, 0.5):
        preset.write_text(f"defaults: [kl, _self_]\nkl: {{weight: {weight}}}\n")
        assert main(["train", "-m", "+reg=mine"]) == 0
    first, second = folders()
    assert first == "reg=mine" and second.startswith("reg=mine_") and len(jobs.done) == 2
    for name, weight in ((first, 0.25), (second, 0.5)):
        assert (
            f"weight: {weight}"
            in Path(f"multirun/procedural/{name}/.hydra/config.yaml").read_text()
        )


def test_study_has_a_folder_of_its_own(jobs: Jobs) -> None:
    assert main(["train", "-m", "name=ablation", "seed=0", "hydra.sweep.dir=studies"]) == 0
    assert folders(Path("studies/ablation")) == ["seed=0"]


def test_interrupted_sweep_is_taken_up_again(
    jobs: Jobs, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs.failing = {1: KeyboardInterrupt()}
    assert main(["train", "-m", "seed=0,1,2"]) == 130
    shown = capsys.readouterr()
    assert (
        shown.out.splitlines()[-1]
        == "3 jobs: 1 done, 0 skipped, 0 failed, 1 interrupted, 1 not begun"
    )
    assert shown.err.splitlines()[-1] == "nerfreg: interrupted"
    assert not Path("multirun/procedural/seed=1/failed.json").exists()
    jobs.failing.clear()
    assert main(["train", "-m", "seed=0,1,2"]) == 0
    assert jobs.done == [0, 1, 1, 2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seeed=0,1"], "unknown key 'seeed'; did you mean 'seed'?"),
        (["seed=0,1", "eval.count=0"], "eval.count=0: must be at least 1"),
        (["+reg=kl", "reg.kl.weight=-1,-2"], "reg.kl.weight=-1.0: must be finite and not negative"),
        (["scene=llff", "scene.path=nowhere", "seed=0,1"], "nowhere"),
        (
            ["seed=0,1", "hydra.sweep.subdir=x"],
            "hydra.sweep.subdir=x: run folders of a sweep are named by",
        ),
        (["seed=0", "hydra/launcher=joblibb"], "unknown choice hydra/launcher=joblibb"),
    ],
)
def test_what_no_job_can_use_is_refused_at_once(
    jobs: Jobs, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["train", "-m", *words]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("nerfreg: error: ") and message in line
    assert not jobs.done and not Path("multirun").exists()


def test_what_one_job_cannot_use_is_its_failure(jobs: Jobs) -> None:
    assert main(["train", "-m", "+reg=kl", "reg.kl.weight=-1,1", "seed=5"]) == 1
    assert jobs.done == [5]
    assert [*Path("multirun").rglob("failed.json")] == [
        Path("multirun/procedural/reg=kl,reg.kl.weight=-1,seed=5/failed.json")
    ]


def test_a_choice_that_does_not_exist_refuses_all(jobs: Jobs) -> None:
    assert main(["train", "-m", "+reg=kl,kll"]) == 2
    assert not jobs.done


def test_launcher_that_is_not_installed(jobs: Jobs, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "-m", "hydra/launcher=nowhere"]) == 2
    assert "more come with pip install 'nerfreg[sweep]'" in capsys.readouterr().err


def test_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    with (
        claimed(tmp_path),
        pytest.raises(BusyError, match="another process is at it"),
        claimed(tmp_path),
    ):
        pass
    with claimed(tmp_path):  # Free again.
        pass


def test_numbers() -> None:
    def entries(*states: JobState) -> list[JobEntry]:
        return [JobEntry(number, "", state, "", {}) for number, state in enumerate(states)]

    assert in_numbers(entries(JobState.DONE), 1) == "1 job: 1 done, 0 skipped, 0 failed"
    both = entries(JobState.FAILED, JobState.BEGUN)
    assert in_numbers(both, 4) == "4 jobs: 0 done, 0 skipped, 1 failed, 1 interrupted, 2 not begun"


class Valley:
    """Stands for training: the error is lowest at a weight of 0.25, and above 0.9 it fails."""

    def __init__(self) -> None:
        self.weights: list[float] = []

    def __call__(self, config: Config, folder: Path) -> None:
        weight = config.reg["kl"].weight
        self.weights.append(weight)
        if weight > 0.9:
            raise NerfregError("too heavy")
        record = {"psnr": 20.0, "average": (weight - 0.25) ** 2, "held_out": True}
        (folder / "results.json").write_text(json.dumps(record))


TUNE = [
    "train",
    "-m",
    "+reg=kl",
    "hydra/sweeper=tune",
    "hydra.sweeper.n_trials=4",
    "reg.kl.weight=interval(0.0,1.0)",
]
HELD_OUT = "scene.held_out=[0]"


@pytest.fixture
def valley(jobs: Jobs, monkeypatch: pytest.MonkeyPatch) -> Valley:
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    monkeypatch.setattr(
        "nerfreg.sweeps.plan.find_lpips_weights", lambda configured: Path("weights")
    )
    valley = Valley()
    monkeypatch.setattr(launch, "train", valley)
    return valley


@pytest.mark.filterwarnings("ignore")  # Optuna's warnings
def test_tuning_minimizes_the_error_of_held_out_views(
    valley: Valley, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main([*TUNE, HELD_OUT]) == 0
    assert len(valley.weights) == len({*valley.weights}) == 4
    best = Path("multirun/optimization_results.yaml").read_text()
    assert f"reg.kl.weight: {min(valley.weights, key=lambda weight: abs(weight - 0.25))}" in best
    # Again the same trials, whose errors are read from their folders.
    assert main([*TUNE, HELD_OUT]) == 0
    assert len(valley.weights) == 4
    assert Path("multirun/optimization_results.yaml").read_text() == best
    assert "4 jobs: 0 done, 4 skipped, 0 failed" in capfd.readouterr().out


@pytest.mark.filterwarnings("ignore")
def test_trial_that_fails_is_left_out(valley: Valley) -> None:
    words = [word.replace("interval(0.0,1.0)", "0.5,1.0") for word in TUNE]
    # Four draws with a fixed seed have both.
    assert main([*words, HELD_OUT]) == 1
    assert {*valley.weights} == {0.5, 1.0}
    assert "reg.kl.weight: 0.5\n" in Path("multirun/optimization_results.yaml").read_text()


@pytest.mark.filterwarnings("ignore")
def test_shipped_ranges_are_those_of_the_presets_plugins(valley: Valley) -> None:
    words = [
        "train",
        "-m",
        "+reg=combinerf",
        "hydra/sweeper=tune_combinerf",
        "hydra.sweeper.n_trials=1",
        HELD_OUT,
    ]
    assert main(words) == 0
    best = Path("multirun/optimization_results.yaml").read_text()
    for name in ("kl", "distortion", "full_geometry", "depth_smoothness"):
        assert f"reg.{name}.weight: " in best


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "hydra/sweeper=tune would choose by test views; set e.g. scene.held_out=[0]"),
        (
            [HELD_OUT, "hydra.sweeper.direction=maximize"],
            "hydra.sweeper.direction=maximize: the objective is the error",
        ),
        (
            [HELD_OUT, "eval.lpips=false"],
            "eval.lpips=false: 'average', which hydra/sweeper=tune minimizes, needs LPIPS",
        ),
    ],
)
def test_tuning_by_anything_else_is_refused(
    valley: Valley, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main([*TUNE, *words]) == 2
    assert message in capsys.readouterr().err
    assert not valley.weights and not Path("multirun").exists()


def test_tuning_without_lpips_weights_is_refused(
    valley: Valley, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("nerfreg.sweeps.plan.find_lpips_weights", lambda configured: None)
    assert main([*TUNE, HELD_OUT]) == 2
    assert (
        "hydra/sweeper=tune minimizes 'average': LPIPS and average are n/a"
        in capsys.readouterr().err
    )


def test_a_job_has_its_share_whatever_the_job_before_left(monkeypatch: pytest.MonkeyPatch) -> None:
    # Eight threads for two jobs at a time; a job before, with four, has left torch with two.
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", 8)
    monkeypatch.setattr("torch.get_num_threads", lambda: 2)
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert _fair_threads(Plan(4, (), 2, False)) == 4
    assert _fair_threads(Plan(4, (), None, False)) == 8
