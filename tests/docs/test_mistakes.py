"""The table of mistakes in `docs/howto/mistakes.md` has the messages that authors get.

Each mistake is planted in a plugin that is installed and selected. After a change of a message,
write the table anew by

    python tests/docs/test_mistakes.py
"""

from __future__ import annotations

import contextlib
import importlib
import io
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
from hydra.core.config_store import ConfigStore

from nerfreg.cli import main
from nerfreg.registry import installed, plugins

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "mistakes.md"
MARK = "<!-- mistakes: written by python tests/docs/test_mistakes.py -->\n"
PREAMBLE = """
from dataclasses import dataclass, field, replace
from typing import ClassVar

import torch
from torch import nn

from nerfreg import *

"""
SMALL = (
    "scene.size=16", "scene.views=2", "scene.test_views=1", "field.levels=2", "field.hidden=8",
    "field.log2_entries=8", "field.finest=16", "sampler.coarse=4", "sampler.fine=4",
    "sampler.skip_resolution=8", "train.rays=32", "train.steps=3", "train.quiet=true",
    "train.threads=1", "eval.lpips=false", "eval.count=1",
)  # fmt: skip
CHECKED, CHECK = "checked", "check"


@dataclass(frozen=True)
class Mistake:
    """A mistake of an author.

    Attributes:
        what: The mistake, in words.
        found: What finds it, as the page calls it.
        body: Of the class `Mine`; a whole module if it begins with `class` or `import`.
        case: For what `nerfreg check` finds, the case in which it does.
    """

    what: str
    found: str
    body: str
    case: str = ""


MISTAKES = (
    Mistake(
        "`@dataclass` is forgotten",
        "loading",
        "class Mine(Regularizer):\n    sharpness: float = 1.0\n",
    ),
    Mistake(
        "`@hookimpl` is forgotten",
        "loading",
        "def nerfreg_loss(self, rendering):\n    return {}\n",
    ),
    Mistake(
        "A hook is misspelt",
        "loading",
        "@hookimpl\ndef nerfreg_losses(self, rendering):\n    return {}\n",
    ),
    Mistake(
        "An argument has another name",
        "loading",
        "@hookimpl\ndef nerfreg_loss(self, renderings):\n    return {}\n",
    ),
    Mistake(
        "`yield` in a hook that is no wrapper",
        "loading",
        "@hookimpl\ndef nerfreg_density(self):\n    density = yield\n    return density * 0.5\n",
    ),
    Mistake(
        "A wrapper without `yield`",
        "loading",
        "@hookimpl(wrapper=True)\ndef nerfreg_density(self, samples):\n"
        "    return samples.density * 0.5\n",
    ),
    Mistake("An option has no type", "loading", "sharpness = 2.0\n"),
    Mistake("An option has no default", "loading", "sharpness: float\n"),
    Mistake("An option is a tuple", "loading", "size: tuple[int, int] = (4, 4)\n"),
    Mistake(
        "`color_inputs` is not declared",
        "loading",
        "@hookimpl\ndef nerfreg_color_input(self, samples):\n"
        "    return torch.zeros(len(samples.ray), 4)\n",
    ),
    Mistake(
        "`in_evaluation` names a hook that is never called there",
        "loading",
        'in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_loss",)\n'
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    return {}\n",
    ),
    Mistake(
        "The module of the plugin cannot be imported",
        "loading",
        "import a_module_that_nobody_has\nclass Mine: pass\n",
    ),
    Mistake(
        "`return` is forgotten",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    {'thin': rendering.opacity.mean()}\n",
    ),
    Mistake(
        "A wrapper returns nothing",
        "running",
        "@hookimpl(wrapper=True)\ndef nerfreg_rays(self):\n    rays = yield\n",
    ),
    Mistake(
        "A term is a number, by `.item()` or `float(...)`",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': rendering.opacity.mean().item()}\n",
    ),
    Mistake(
        "A term is not reduced",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    return {'thin': rendering.opacity}\n",
    ),
    Mistake(
        "A term alone, and no dictionary",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    return rendering.opacity.mean()\n",
    ),
    Mistake(
        "A term is in double precision",
        CHECKED,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': rendering.opacity.double().mean()}\n",
    ),
    Mistake(
        "Something fails inside of a hook",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': rendering.opacities.mean()}\n",
    ),
    Mistake(
        "What was asked for is not there in every step",
        "running",
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'rough': rendering.rays.patches.float().mean()}\n",
    ),
    Mistake(
        "`nerfreg_prepare` returns another shape",
        "running",
        "@hookimpl\ndef nerfreg_prepare(self, photographs):\n"
        "    return {'grey': photographs.images.mean(dim=(1, 2))}\n",
    ),
    Mistake(
        "`nerfreg_module` returns parameters in place of a module",
        "running",
        "@hookimpl\ndef nerfreg_module(self):\n    return nn.Parameter(torch.zeros(3))\n",
    ),
    Mistake(
        "An encoder has no width",
        "running",
        "@hookimpl\ndef nerfreg_encoder(self):\n    return nn.Linear(3, 8)\n",
    ),
    Mistake(
        "`nerfreg_density` returns another shape",
        "running",
        "@hookimpl(wrapper=True)\ndef nerfreg_density(self):\n"
        "    density = yield\n    return density.flatten()\n",
    ),
    Mistake(
        "`nerfreg_occupancy` returns the cells without their place",
        "running",
        "@hookimpl\ndef nerfreg_occupancy(self):\n"
        "    return torch.ones(64, 64, 64, dtype=torch.bool)\n",
    ),
    Mistake(
        "`nerfreg_empty` returns numbers in place of booleans",
        "running",
        "@hookimpl\ndef nerfreg_empty(self, positions):\n"
        "    return (positions[:, 2] < 0).float()\n",
    ),
    Mistake(
        "`nerfreg_color_input` returns another width",
        "running",
        "@property\ndef color_inputs(self):\n    return 4\n"
        "@hookimpl\ndef nerfreg_color_input(self, samples):\n    return samples.positions\n",
    ),
    Mistake(
        "A buffer is updated before the gradient is known",
        "running",
        "@hookimpl\ndef nerfreg_module(self):\n    self._kept = nn.Module()\n"
        "    self._kept.register_buffer('scale', torch.ones(()))\n    return self._kept\n"
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    loss = (self._kept.scale * rendering.opacity).mean()\n"
        "    self._kept.scale.mul_(0.9)\n    return {'thin': loss}\n",
    ),
    Mistake(
        "The rendering is changed in place",
        CHECKED,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    rendering.depth.data.div_(2.0)\n    return {'thin': rendering.opacity.mean()}\n",
    ),
    Mistake(
        "What belongs to a step stays in force",
        "leak",
        "in_evaluation: ClassVar[tuple[str, ...]] = ('nerfreg_density',)\n"
        "mask: ClassVar = 1.0\n"
        "@hookimpl(wrapper=True)\ndef nerfreg_density(self):\n"
        "    density = yield\n    return density * self.mask\n"
        "@hookimpl\ndef nerfreg_loss(self):\n    self.mask = 0.0\n    return {}\n",
    ),
    Mistake(
        "A layer keeps the noise of the last step",
        "leak",
        "@hookimpl(wrapper=True)\ndef nerfreg_layer(self):\n"
        "    layer = yield\n    self._layer = Noisy(layer)\n    return self._layer\n"
        "@hookimpl\ndef nerfreg_loss(self):\n    self._layer.scale = 3.0\n    return {}\n",
    ),
    Mistake(
        "What was learned is in neither a module nor `state_dict`",
        "leak",
        "in_evaluation: ClassVar[tuple[str, ...]] = ('nerfreg_rendering',)\n"
        "def __post_init__(self):\n    self._gain = 1.0\n"
        "@hookimpl(wrapper=True)\ndef nerfreg_rendering(self):\n"
        "    rendering = yield\n    return replace(rendering, rgb=rendering.rgb * self._gain)\n"
        "@hookimpl\ndef nerfreg_step_end(self):\n    self._gain *= 0.9\n",
    ),
    Mistake(
        "Random numbers from a global generator",
        CHECK,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    opacity = rendering.opacity\n"
        "    return {'thin': opacity.mean() * torch.rand(1)[0]}\n",
        "steps",
    ),
    Mistake(
        "A term without gradient",
        CHECK,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': torch.tensor(rendering.opacity.mean().item())}\n",
        "terms",
    ),
    Mistake(
        "A root or logarithm of 0",
        CHECK,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': rendering.opacity.sqrt().mean()}\n",
        "empty",
    ),
    Mistake(
        "A sum over rays in place of a mean",
        CHECK,
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n"
        "    return {'thin': rendering.opacity.sum()}\n",
        "fog",
    ),
    Mistake(
        "Renderings are kept on `self`",
        CHECK,
        "def __post_init__(self):\n    self._seen = []\n"
        "@hookimpl\ndef nerfreg_loss(self, rendering):\n    self._seen.append(rendering)\n"
        "    return {'thin': rendering.opacity.mean()}\n",
        "steps",
    ),
)
NOISY = """
class Noisy(WrappedLayer):
    scale = 1.0

    def effective(self):
        weight, bias = self.inner.effective()
        return weight * self.scale, bias

"""


def code(mistake: Mistake) -> str:
    """The module of a plugin with this mistake."""
    if re.match(r"class |import ", mistake.body):
        return PREAMBLE + mistake.body
    body = re.sub(r"^(?=.)", "    ", mistake.body, flags=re.M)
    return f"{PREAMBLE}{NOISY}@dataclass\nclass Mine(Regularizer):\n    pass\n{body}"


@contextlib.contextmanager
def planted(mistake: Mistake, folder: Path) -> Iterator[None]:
    """Within this context, the plugin `mine` is installed."""
    (folder / "mine.py").write_text(code(mistake), encoding="utf-8")
    importlib.invalidate_caches()
    package = SimpleNamespace(name="nerfreg-mine", version="1.0")
    points = [
        *plugins._entry_points(),
        EntryPoint("mine", "mine:Mine", plugins.GROUP)._for(package),
    ]
    with (
        mock.patch.object(plugins, "_entry_points", lambda: points),
        mock.patch.object(sys, "path", [str(folder), *sys.path]),
        contextlib.chdir(folder),
    ):
        try:
            yield
        finally:
            sys.modules.pop("mine", None)
            ConfigStore.instance().repo.pop("reg", None)


def message(mistake: Mistake, folder: Path) -> tuple[str, int]:
    """What an author reads, and the exit code."""
    with planted(mistake, folder):
        if mistake.found == "loading":
            [plugin] = [plugin for plugin in installed() if plugin.name == "mine"]
            return plugin.error, 2
        if mistake.found == CHECK:
            return _first_failure(mistake.case)
        words = ["+reg=mine", "hydra.run.dir=run", *SMALL]
        words += ["train.check=true"] if mistake.found == CHECKED else []
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
            code = main(["train", *words])
    lines = [line for line in errors.getvalue().splitlines() if line.startswith("nerfreg: error: ")]
    told = lines[-1].removeprefix("nerfreg: error: ") if lines else ""
    # How much a leak changes depends on the machine.
    return re.sub(r"differs by \S+", "differs by 0.12", told), code


def _first_failure(case: str) -> tuple[str, int]:
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = main(["check", "mine", "--case", case, "--dtype", "float32"])
    # The types of a test run are checked by beartype, which draws from Python's module random.
    told = next(
        line
        for line in output.getvalue().splitlines()
        if re.match(r"mine: \w+: ", line) and "module random" not in line
    )
    # These numbers depend on the machine.
    return re.sub(r": \S+ became \S+", ": 0.3 became 0.6", told), code


def row(mistake: Mistake, told: str) -> str:
    text = told.replace("|", "\\|")
    return f"| {mistake.what} | {mistake.found} | `{text}` |"


def rows() -> list[str]:
    """The rows of the page."""
    return PAGE.read_text(encoding="utf-8").partition(MARK)[2].strip().splitlines()[2:]


def test_every_mistake_has_a_row() -> None:
    assert len(rows()) == len(MISTAKES)


@pytest.mark.parametrize(
    ("number", "mistake"), [*enumerate(MISTAKES)], ids=[mistake.what for mistake in MISTAKES]
)
def test_message_is_that_of_the_page(number: int, mistake: Mistake, tmp_path: Path) -> None:
    told, code = message(mistake, tmp_path)
    assert rows()[number] == row(mistake, told)
    assert told and code == {"loading": 2, CHECK: 1}.get(mistake.found, 4)


def write() -> None:
    """Write the table of the page anew."""
    lines = ["| mistake | found by | message |", "| --- | --- | --- |"]
    for mistake in MISTAKES:
        with tempfile.TemporaryDirectory() as folder:
            told, code = message(mistake, Path(folder))
        print(code, mistake.what, "\n   ", told)
        lines.append(row(mistake, told))
    text = PAGE.read_text(encoding="utf-8").partition(MARK)[0]
    PAGE.write_text(text + MARK + "\n" + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write()
