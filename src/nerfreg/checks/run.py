"""`nerfreg check`: plugins against stiff and extreme cases."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout

from omegaconf import OmegaConf
from rich.console import Console

from nerfreg.checks.cases import CASES, Case
from nerfreg.checks.compositor import check_compositing
from nerfreg.checks.cost import COST_CASE, check_cost
from nerfreg.checks.inputs import DTYPES
from nerfreg.checks.layers import LAYER_CASES, LayerCase, check_layers
from nerfreg.checks.losses import check_losses
from nerfreg.checks.photographs import (
    PHOTOGRAPH_CASES,
    PhotographCase,
    check_known_depth,
    check_prepare,
)
from nerfreg.checks.report import Report
from nerfreg.checks.small_run import RUN_CASE, check_run
from nerfreg.checks.steps import STEPS_CASE, RunCase, check_steps
from nerfreg.checks.subject import Subject
from nerfreg.checks.tables import print_json, print_reports
from nerfreg.checks.terms import TERMS_CASE, check_terms
from nerfreg.checks.thread_count import threads_set
from nerfreg.checks.transforms import (
    RENDERING_HOOKS,
    check_encoder_input,
    check_needs,
    check_ray_bounds,
    check_rendering,
)
from nerfreg.errors import NerfregError, nearest
from nerfreg.registry import installed
from nerfreg.registry.plugins import HOOKS

AnyCase = Case | LayerCase | PhotographCase | RunCase
ALL_CASES: tuple[AnyCase, ...] = (
    *CASES,
    *LAYER_CASES,
    *PHOTOGRAPH_CASES,
    TERMS_CASE,
    STEPS_CASE,
    COST_CASE,
    RUN_CASE,
)
COMPOSITOR = Subject("compositing", ("core",), OmegaConf.create())
PLUGIN = tuple(hook.removeprefix("nerfreg_") for hook in HOOKS)
Check = tuple[tuple[str, ...], str, Callable[..., None]]
CHECKS_OF: dict[type[AnyCase] | AnyCase, tuple[Check, ...]] = {
    Case: (
        (("core",), "value", check_compositing),
        (("needs",), "contract", check_needs),
        (("ray_bounds",), "contract", check_ray_bounds),
        (("encoder_input",), "contract", check_encoder_input),
        (RENDERING_HOOKS, "contract", check_rendering),
        (("loss",), "value", check_losses),
    ),
    LayerCase: ((("layer",), "value", check_layers),),
    PhotographCase: (
        (("known_depth",), "value", check_known_depth),
        (("prepare",), "contract", check_prepare),
    ),
    TERMS_CASE: ((("loss",), "gradient", check_terms),),
    STEPS_CASE: ((PLUGIN, "steps", check_steps),),
    COST_CASE: ((PLUGIN, "cost", check_cost),),
    RUN_CASE: ((PLUGIN, "run", check_run),),
}
"""What a case, or a kind of them, is for: hooks of which the plugin must have one, what has failed
if the plugin raises, and the check."""


def check_plugin(
    subject: Subject,
    cases: Sequence[AnyCase] = ALL_CASES,
    dtypes: Sequence[str] = tuple(DTYPES),
    samples: int | None = None,
) -> Report:
    """Check one plugin over cases, precisions and numbers of samples.

    Args:
        subject: The plugin.
        cases: Each is used for the hooks by which the plugin takes part in a run.
        dtypes: Names of precisions.
        samples: Number of samples on a ray, in place of those of each case.
    """
    report = Report(subject)
    points = ((case, *point) for case in cases for point in case.points(dtypes, samples))
    for case, spot, given in points:
        for hooks, failing, check in CHECKS_OF.get(case) or CHECKS_OF[type(case)]:
            if any(hook in subject.hook_points for hook in hooks):
                with threads_set(1), report.at(spot, failing):
                    check(report, case, given)
    return report


def run(
    words: Sequence[str],
    case: str | None = None,
    dtype: str | None = None,
    samples: int | None = None,
    as_document: bool = False,
) -> int:
    """Check plugins, and print what was found.

    Args:
        words: Names of plugins, and overrides `reg.NAME.key=value`. Without a name all plugins and
            the compositor are checked.
        case: Name of a case; None: all of them.
        dtype: Name of a precision; None: all of them.
        samples: Number of samples on a ray; None: those of each case.
        as_document: Whether to print one JSON document in place of a table.

    Returns:
        1 if anything failed, else 0.

    Raises:
        NerfregError: A plugin, case or key is not known.
    """
    cases = [known for known in ALL_CASES if case in (None, known.name)]
    if not cases:
        raise NerfregError(f"--case {case}: {nearest(str(case), (c.name for c in ALL_CASES))}")
    dtypes = tuple(DTYPES) if dtype is None else (dtype,)
    subjects, reports = _subjects(words), []
    # What a plugin prints must not get into the report, which a program may read.
    with redirect_stdout(sys.stderr), Console(stderr=True).status("checking") as status:
        for subject in subjects:
            status.update(f"checking {subject.name}")
            reports.append(check_plugin(subject, cases, dtypes, samples))
    show = print_json if as_document else print_reports
    show(reports)
    return 1 if any(report.failures for report in reports) else 0


def _subjects(words: Sequence[str]) -> list[Subject]:
    """What to check; broken plugins are an error if they were named, else a warning."""
    names, overrides = [word for word in words if "=" not in word], _overrides(words)
    found = {plugin.address: plugin for plugin in installed()}
    known = (*found, COMPOSITOR.name)
    for name in (*names, *overrides):
        if name not in known:
            raise NerfregError(f"unknown plugin '{name}'; {nearest(name, known)}")
        if names and name not in names:
            raise NerfregError(f"{overrides[name][0]}: plugin '{name}' is not checked; name it too")
    subjects = [COMPOSITOR] if COMPOSITOR.name in (names or known) else []
    for name in (name for name in found if name in (names or known)):
        plugin = found[name]
        broken = f"plugin '{name}' of package {plugin.package}: {plugin.error}"
        if plugin.cls is not None:
            subjects.append(Subject.of(plugin, overrides.get(name, ())))
        elif names:
            raise NerfregError(broken)
        else:
            print(f"nerfreg: warning: left out {broken}", file=sys.stderr)
    return subjects


def _overrides(words: Sequence[str]) -> dict[str, list[str]]:
    """By plugin."""
    overrides = defaultdict(list)
    for word in (word for word in words if "=" in word):
        parts = word.partition("=")[0].split(".")
        if len(parts) != 3 or parts[0] != "reg":
            raise NerfregError(f"'{word}' is no plugin and no override; write reg.NAME.key=value")
        overrides[parts[1]].append(word)
    return overrides


def listing() -> str:
    """Return a line for each case, with its name and what it is."""
    width = max(len(case.name) for case in ALL_CASES)
    return "\n".join(f"{case.name:<{width}}  {case.description}" for case in ALL_CASES)
