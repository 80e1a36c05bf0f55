from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TEST = """
import torch

def test_gradient(rendering, step):
    value = (rendering.opacity * step.fraction).mean()
    assert torch.autograd.grad(value, rendering.density)[0].all()

def test_extremes(extreme_rendering):
    assert extreme_rendering.weights.isfinite().all()

def test_scene(small_scene):
    assert len(small_scene.train) == 3
"""


def test_fixtures_of_another_project(environment: dict[str, str], tmp_path: Path) -> None:
    plugins = 'pytest_plugins = ["nerfreg.testing.fixtures"]\n'
    (tmp_path / "conftest.py").write_text(plugins, encoding="utf-8")
    (tmp_path / "test_it.py").write_text(TEST, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "30 passed" in done.stdout


def test_nothing_else_needs_pytest(environment: dict[str, str]) -> None:
    code = "import sys; sys.modules['pytest'] = None; import nerfreg.testing"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
