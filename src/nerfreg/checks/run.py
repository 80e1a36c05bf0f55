"""`nerfreg check`: plugins against stiff and extreme cases."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.console import Console

from nerfreg.checks import compositor
from nerfreg.checks.cases import CASES
from nerfreg.checks.grid import Grid, check_compositor, check_plugin
from nerfreg.checks.inputs import DTYPES
from nerfreg.checks.layers import LAYER_CASES
from nerfreg.checks.photographs import PHOTOGRAPH_CASES
from nerfreg.checks.report import Report
from nerfreg.checks.subject import Subject, make_subject
from nerfreg.checks.table import as_json, print_reports
from nerfreg.errors import NerfregError, nearest
from nerfreg.registry import PluginInfo, installed

ALL_CASES = (*CASES, *LAYER_CASES, *PHOTOGRAPH_CASES)


@dataclass(frozen=True)
class Selection:
    """What is checked of a plugin; None stands for everything.

    Attributes:
        case: Name of a case.
        dtype: Name of a precision.
        samples: Number of samples on a ray.
    """

    case: str | None = None
    dtype: str | None = None
    samples: int | None = None

    def __post_init__(self) -> None:
        names = [case.name for case in ALL_CASES]
        if self.case is not None and self.case not in names:
            raise NerfregError(f"--case {self.case}: {nearest(self.case, names)}")

    def grid(self) -> Grid:
        """Return the cases, precisions and sizes that are selected."""
        return Grid(
            cases=tuple(case for case in CASES if self.case in (None, case.name)),
            layer_cases=tuple(case for case in LAYER_CASES if self.case in (None, case.name)),
            photograph_cases=tuple(c for c in PHOTOGRAPH_CASES if self.case in (None, c.name)),
            dtypes=tuple(DTYPES) if self.dtype is None else (self.dtype,),
            samples=self.samples,
        )


def run(words: Sequence[str], selection: Selection, as_document: bool = False) -> int:
    """Check plugins, and print what was found.

    Args:
        words: Names of plugins, and overrides `reg.NAME.key=value`. Without a name all plugins and
            the compositor are checked.
        selection: What is checked of each.
        as_document: Whether to print one JSON document in place of a table.

    Returns:
        1 if anything failed, else 0.

    Raises:
        NerfregError: A plugin or key is not known.
    """
    plugins, overrides = _parted(words)
    subjects = _subjects(plugins, overrides)
    grid = selection.grid()
    reports: list[Report] = []
    with Console(stderr=True).status("checking") as status:
        if not plugins or compositor.NAME in plugins:
            status.update(f"checking {compositor.NAME}")
            reports.append(check_compositor(grid))
        for subject in subjects:
            status.update(f"checking {subject.name}")
            reports.append(check_plugin(subject, grid))
    if as_document:
        print(as_json(reports))
    else:
        print_reports(reports)
    return 0 if all(report.passed for report in reports) else 1


def _parted(words: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """Names of plugins, and overrides by plugin."""
    plugins: list[str] = []
    overrides: dict[str, list[str]] = defaultdict(list)
    for word in words:
        name, equals, _ = word.partition("=")
        if not equals:
            plugins.append(word)
        elif name.startswith("reg.") and name.count(".") == 2:
            overrides[name.split(".")[1]].append(word)
        else:
            raise NerfregError(f"'{word}' is no plugin and no override; write reg.NAME.key=value")
    return plugins, overrides


def _subjects(plugins: Sequence[str], overrides: Mapping[str, Sequence[str]]) -> list[Subject]:
    """The plugins to check; broken ones are an error if they were named, else a warning."""
    found = {plugin.name: plugin for plugin in installed()}
    for name in (*plugins, *overrides):
        if name not in found and name != compositor.NAME:
            raise NerfregError(
                f"unknown plugin '{name}'; {nearest(name, (*found, compositor.NAME))}"
            )
        if plugins and name not in plugins:
            raise NerfregError(f"{overrides[name][0]}: plugin '{name}' is not checked; name it too")
    subjects = []
    for name, plugin in found.items():
        if plugins and name not in plugins:
            continue
        if plugin.cls is not None:
            subjects.append(make_subject(plugin, overrides.get(name, ())))
        elif plugins:
            raise NerfregError(_broken(plugin))
        else:
            print(f"nerfreg: warning: left out {_broken(plugin)}", file=sys.stderr)
    return subjects


def _broken(plugin: PluginInfo) -> str:
    return f"plugin '{plugin.name}' of package {plugin.package}: {plugin.error}"


def listing() -> str:
    cases = [(case.name, case.description) for case in ALL_CASES]
    width = max(len(name) for name, _ in cases)
    return "\n".join(f"{name:<{width}}  {description}" for name, description in cases)
