"""Sweeps in other processes, and one that is really interrupted.

Each engine is skipped where it is not installed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

TINY = [
    "scene.size=8", "scene.views=2", "scene.test_views=1", "field.levels=2", "field.log2_entries=8",
    "train.steps=2", "train.rays=8", "eval.lpips=false", "eval.count=1",
]  # fmt: skip
LAUNCHERS = {
    "joblib": ("hydra_joblib_launcher", ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]),
    "submitit_local": ("hydra_submitit_launcher", ["hydra/launcher=submitit_local"]),
    "ray": (
        "hydra_ray_launcher",
        ["hydra/launcher=ray", "+hydra.launcher.ray.init.include_dashboard=false"],
    ),
}


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "nerfreg", "train", "-m", *words]


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_jobs_run_in_other_processes(
    launcher: str, tmp_path: Path, environment: dict[str, str]
) -> None:
    package, choice = LAUNCHERS[launcher]
    pytest.importorskip(f"hydra_plugins.{package}")
    # A home of its own, because Ray keeps files there.
    environment = {**environment, "HOME": str(tmp_path / "home")}
    words = ["+reg=kl", "device=cpu,nonsense", "seed=0", *choice, *TINY]
    done = subprocess.run(
        command(*words), cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    assert "2 jobs: 1 done, 0 skipped, 1 failed" in done.stdout
    [results] = tmp_path.glob("multirun/procedural/*/results.json")
    [failed] = tmp_path.glob("multirun/procedural/*/failed.json")
    assert "device=nonsense" in failed.parent.name
    assert json.loads(failed.read_text())["error"] == "NerfregError"
    # Each of the two jobs has half of the cores, and at least one.
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    assert json.loads(results.read_text())["threads"] in {1, cores // 2}


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
@pytest.mark.parametrize("launcher", ["basic", pytest.param("joblib", marks=pytest.mark.slow)])
def test_interrupt_leaves_whole_runs_whole(
    launcher: str, tmp_path: Path, environment: dict[str, str]
) -> None:
    choice: list[str] = []
    if launcher == "joblib":
        pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
        choice = LAUNCHERS["joblib"][1]
    # One job ends after two steps; the other would go on for an hour.
    words = [
        "train.seconds=3600",
        "train.steps=2,null",
        *choice,
        *TINY[:5],
        *TINY[6:],
        "train.quiet=true",
    ]
    # What a shell starts in the background ignores Ctrl-C, and so do its children.
    listening = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    sweep = subprocess.Popen(
        command(*words),
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=listening,
    )
    try:
        deadline = time.monotonic() + 120
        while not (
            [*tmp_path.rglob("results.json")] and [*tmp_path.glob("multirun/.jobs/*/1.json")]
        ):
            assert sweep.poll() is None and time.monotonic() < deadline
            time.sleep(0.1)
        os.killpg(sweep.pid, signal.SIGINT)  # As a terminal does on Ctrl-C.
        shown, _ = sweep.communicate(timeout=60)
    finally:
        if sweep.poll() is None:
            os.killpg(sweep.pid, signal.SIGKILL)
    assert sweep.returncode == 130
    assert "2 jobs: 1 done, 0 skipped, 0 failed, 1 interrupted" in shown
    [whole] = tmp_path.rglob("results.json")
    assert json.loads(whole.read_text())["step"] == 2
    assert not [*tmp_path.rglob("failed.json")]
