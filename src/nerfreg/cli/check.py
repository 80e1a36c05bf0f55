"""`nerfreg check`: plugins against stiff and extreme cases."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

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


@dataclass
class Options:
    """The command line. overrides: `reg.NAME.key=value` by plugin."""

    plugins: list[str] = field(default_factory=list)
    overrides: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    case: str | None = None
    dtype: str | None = None
    samples: int | None = None
    replay: str | None = None
    json: bool = False
    listing: bool = False


def run(words: Sequence[str]) -> int:
    """Check the plugins that are named, or all and the compositor; returns 1 if anything failed, else 0.

    Raises NerfregError for plugins, cases and options that do not exist.
    """
    options = parse(words)
    if options.listing:
        print(_listing())
        return 0
    if options.replay is not None:
        from nerfreg.runs.replay import replay

        return replay(Path(options.replay))
    subjects = _subjects(options)
    grid = _grid(options)
    reports: list[Report] = []
    with Console(stderr=True).status("checking") as status:
        if not options.plugins or compositor.NAME in options.plugins:
            status.update(f"checking {compositor.NAME}")
            reports.append(check_compositor(grid))
        for subject in subjects:
            status.update(f"checking {subject.name}")
            reports.append(check_plugin(subject, grid))
    if options.json:
        print(as_json(reports))
    else:
        print_reports(reports)
    return 0 if all(report.passed for report in reports) else 1


def parse(words: Sequence[str]) -> Options:
    """The words after `nerfreg check`."""
    options = Options()
    rest = iter(words)
    for word in rest:
        name, equals, value = word.partition("=")
        if word == "--json":
            options.json = True
        elif word == "--list":
            options.listing = True
        elif name in ("--case", "--dtype", "--samples", "--replay"):
            _set(options, name.removeprefix("--"), value if equals else _next(name, rest))
        elif name.startswith("-"):
            known = ("--case", "--dtype", "--samples", "--replay", "--json", "--list")
            raise NerfregError(f"unknown option '{name}'; {nearest(name, known)}")
        elif equals:
            plugin = name.split(".")[1:2]
            if not (name.startswith("reg.") and name.count(".") == 2):
                raise NerfregError(
                    f"'{word}' is no plugin and no override; write reg.NAME.key=value"
                )
            options.overrides[plugin[0]].append(word)
        else:
            options.plugins.append(word)
    return options


def _next(name: str, rest: Iterator[str]) -> str:
    value = next(rest, None)
    if value is None:
        raise NerfregError(f"{name} needs a value")
    return value


def _set(options: Options, key: str, value: str) -> None:
    if key == "samples":
        if not value.isdigit() or int(value) == 0:
            raise NerfregError(f"--samples {value}: must be a whole number, at least 1")
        options.samples = int(value)
        return
    choices = {"case": [case.name for case in ALL_CASES], "dtype": list(DTYPES)}
    if key in choices and value not in choices[key]:
        raise NerfregError(f"--{key} {value}: {nearest(value, choices[key])}")
    setattr(options, key, value)


def _grid(options: Options) -> Grid:
    return Grid(
        cases=tuple(case for case in CASES if options.case in (None, case.name)),
        layer_cases=tuple(case for case in LAYER_CASES if options.case in (None, case.name)),
        photograph_cases=tuple(
            case for case in PHOTOGRAPH_CASES if options.case in (None, case.name)
        ),
        dtypes=tuple(DTYPES) if options.dtype is None else (options.dtype,),
        samples=options.samples,
    )


def _subjects(options: Options) -> list[Subject]:
    """The plugins to check; broken ones are an error if they were named, else a warning."""
    found = {plugin.name: plugin for plugin in installed()}
    for name in (*options.plugins, *options.overrides):
        if name not in found and name != compositor.NAME:
            raise NerfregError(
                f"unknown plugin '{name}'; {nearest(name, (*found, compositor.NAME))}"
            )
        if options.plugins and name not in options.plugins:
            raise NerfregError(
                f"{options.overrides[name][0]}: plugin '{name}' is not checked; name it too"
            )
    subjects = []
    for name, plugin in found.items():
        if options.plugins and name not in options.plugins:
            continue
        if plugin.cls is not None:
            subjects.append(make_subject(plugin, options.overrides.get(name, ())))
        elif options.plugins:
            raise NerfregError(_broken(plugin))
        else:
            print(f"nerfreg: warning: left out {_broken(plugin)}", file=sys.stderr)
    return subjects


def _broken(plugin: PluginInfo) -> str:
    return f"plugin '{plugin.name}' of package {plugin.package}: {plugin.error}"


def _listing() -> str:
    cases = [(case.name, case.description) for case in ALL_CASES]
    width = max(len(name) for name, _ in cases)
    return "\n".join(f"{name:<{width}}  {description}" for name, description in cases)
