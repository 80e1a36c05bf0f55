"""One line for each way in which a configuration can fail to compose."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)
from yaml import YAMLError

from nerfreg.config.folders import choices_on_disk, groups_on_disk
from nerfreg.config.plugin_store import refusal, split_choice
from nerfreg.config.search_path import options
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer
from nerfreg.registry import PluginInfo
from nerfreg.registry.plugin_fields import schedulable_fields

COMPOSITION_ERRORS = (HydraException, OmegaConfBaseException, YAMLError)
GROUP_OF_KEYS = "is a group of keys; `nerfreg train --cfg job` shows them"
ANOTHER_NAME = "give one of them another name, as in +reg=plugin@name"
EXTRA = ("hydra/launcher", "hydra/sweeper")
"""Groups whose choices come with packages that are not installed by default."""


class Refused(BaseException):
    """Carries a NerfregError past Hydra.

    Not an Exception, because Hydra prints a message of its own for every Exception.

    Attributes:
        error: What is carried.
    """

    def __init__(self, error: NerfregError) -> None:
        super().__init__(str(error))
        self.error = error


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse what Hydra would answer in terms of its own: a second `+reg=`, and `field=5`.

    Raises:
        NerfregError: There is one, with what may have been meant.
    """
    for override in overrides:
        group, _, values = override.lstrip("+").partition("=")
        # Hydra reads these words as a number or a boolean, and names of choices are strings.
        for value in values.split(",") if group in groups_on_disk() else ():
            if re.fullmatch(r"[+-]?[\d.]+(e[+-]?\d+)?|true|false", value, re.IGNORECASE):
                hint = nearest(value, choices_on_disk(group))
                raise NerfregError(f"unknown choice {group}={value}; {hint}")
    chosen = [override for override in overrides if re.match(r"\+*reg=", override)]
    choices = [override.split("=", 1)[1].strip("[]") for override in chosen]
    if len(choices) > 1:
        raise NerfregError(
            f"reg is chosen {len(choices)} times; write one list: '+reg=[{','.join(choices)}]'"
        )
    for override in chosen:
        # Each list by itself: a sweep has several.
        for listed in re.findall(r"\[([^\]]*)\]", override):
            _refuse_equal_names([word.strip(" '\"") for word in listed.split(",")])


def explain(error: Exception, plugins: Sequence[PluginInfo], overrides: Sequence[str] = ()) -> str:
    """Return what is wrong (file, key, value) and what to do about it, in one line.

    Args:
        error: One of `COMPOSITION_ERRORS`.
        plugins: The installed plugins.
        overrides: The command line, for messages that repeat a word of it.
    """
    causes = list(_causes(error))
    for cause in causes:
        if isinstance(cause, (ConfigKeyError, ConfigAttributeError)):
            return _where(error) + _unknown_key(cause, plugins)
    for cause in causes:
        if isinstance(cause, MissingMandatoryValue):
            return f"{cause.full_key} has no value; add {cause.full_key}=..."
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            if match := re.search(r"not a subclass of \w+Config. value: (.*)", str(cause)):
                return f"{cause.full_key}={match[1]}: {GROUP_OF_KEYS}"
            if why := _no_schedule(cause):
                return f"{_where(error)}{cause.full_key}: {why}"
            return f"{_where(error)}{cause.full_key}: {_first_line(cause)}"
    if isinstance(error, MissingConfigException):
        return _unknown_choice(error, plugins)
    if isinstance(error, OverrideParseException):
        advice = "quote lists, as in '+reg=[kl,lipschitz]'"
        return f"cannot read '{error.override}': {_first_line(error)}; {advice}"
    text = str(error)
    if match := re.match(r"In 'reg/([^']+)': ValidationError raised .*\s+.*Merge error", text):
        return f"plugin {match[1]} would have the name of another plugin; {ANOTHER_NAME}"
    if match := re.match(r"Could not override '([\w/]+)'. No match in the defaults list", text):
        override = next(
            (word for word in overrides if word.startswith(f"{match[1]}=")), f"{match[1]}=..."
        )
        return (
            f"{override}: no {match[1]} is chosen by default that this could replace; "
            f"write +{override}"
        )
    if match := re.match(r"Ambiguous value for argument '(.*)=(.*)'", text):
        key, values = match.groups()
        advice = f"write '{key}=[{values}]' for a list, or -m to sweep over them"
        return f"'{key}={values}' is several values; {advice}"
    return " ".join(text.split())


def _refuse_equal_names(choices: Sequence[str]) -> None:
    """Refuse two plugins whose settings would stand under one key."""
    names = [split_choice(choice)[1] for choice in choices]
    for choice, name in zip(choices, names, strict=True):
        if names.count(name) > 1 and choices.count(choice) == 1:
            raise NerfregError(f"+reg=: two plugins would be called '{name}'; {ANOTHER_NAME}")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _first_line(error: BaseException) -> str:
    # What a resolver of ours refuses explains itself.
    text = str(error).strip().removeprefix("NerfregError raised while resolving interpolation: ")
    return text.partition("\n")[0].rstrip(".")


def _where(error: BaseException) -> str:
    """The config file that Hydra was reading, if it was reading one."""
    match = re.match(r"In '([^']+)':", str(error))
    return f"in {match[1]}.yaml: " if match else ""


def _no_schedule(error: OmegaConfBaseException) -> str:
    """Why a field has no schedule, if it was given one."""
    cls = error.object_type
    if not (isinstance(cls, type) and issubclass(cls, Regularizer)) or "'schedule'" not in str(
        error
    ):
        return ""
    fields = schedulable_fields(cls)
    if error.key in fields:
        return ""
    return f"follows no schedule; of this plugin {', '.join(fields)} can"


def _unknown_key(
    error: ConfigKeyError | ConfigAttributeError, plugins: Sequence[PluginInfo]
) -> str:
    full_key, key = str(error.full_key), str(error.key)
    parent = full_key.removesuffix(key)
    if parent == "reg.":
        return _unselected(key, plugins)
    known = [f"{parent}{name}" for name in error.parent_node or ()]
    return f"unknown key '{full_key}'; {nearest(full_key, known)}"


def _unselected(name: str, plugins: Sequence[PluginInfo]) -> str:
    known = options("reg", plugins)
    if name in known:
        return f"reg.{name} is not selected; add +reg={name}"
    return f"unknown plugin '{name}' in reg.{name}; {nearest(name, known)}"


def _unknown_choice(error: MissingConfigException, plugins: Sequence[PluginInfo]) -> str:
    missing = str(error.missing_cfg_file)
    group, _, name = missing.rpartition("/")
    if not group:
        advice = "nerfreg train --info searchpath shows it"
        return f"no config file '{missing}.yaml' in the search path; {advice}"
    if group == "reg":
        if why := refusal(name, plugins):
            return f"reg={name}: {why}" if ":" in name or "@" in name else why
        hint = nearest(name.partition("@")[0], options(group, plugins))
        return f"unknown plugin or preset '{name}' in reg={name}; {hint}"
    known = (
        option
        for option in error.options or options(group, plugins)
        if not option.endswith("_schema")
    )
    extra = "; more come with pip install 'nerfreg[sweep]'" if group in EXTRA else ""
    return f"unknown choice {group}={name}; {nearest(name, known)}{extra}"
