"""Values that OmegaConf has no type for: a number or its schedule, and one of some choices.

Both are leaves, a schedule's mapping included, so that a later value replaces an earlier one as a
whole: the keys of two schedules must not be mixed.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from omegaconf import OmegaConf, ValueNode
from omegaconf.base import Metadata, Node
from omegaconf.errors import ValidationError

from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks.schedule import EXAMPLE, Schedule


class NumberNode(ValueNode):
    """A number, or the mapping of a schedule.

    Args:
        value: The number or mapping; a string may be an interpolation.
        key: Key of the node in its parent.
    """

    def __init__(self, value: Any = 0.0, key: Any = None) -> None:
        # The reference type is what makes OmegaConf ask this node about every value.
        metadata = Metadata(ref_type=float, object_type=float, optional=False, key=key)
        super().__init__(parent=None, value=value, metadata=metadata)

    def _validate_and_convert_impl(self, value: Any) -> Any:
        value = _plain(value)
        if isinstance(value, Mapping):
            # Interpolations are resolved later, and it is read again then.
            if "${" not in str(value):
                try:
                    Schedule.read(value)
                except NerfregError as error:
                    raise ValidationError(str(error)) from error
            return deepcopy(dict(value))
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                return float(value)
            except ValueError:
                pass
        raise ValidationError(f"'{value}' is neither a number nor a schedule such as {EXAMPLE}")

    def __deepcopy__(self, memo: dict[int, Any]) -> NumberNode:
        copy = type(self)()
        self._deepcopy_impl(copy, memo)
        return copy


class ChoiceNode(ValueNode):
    """One of some values: the type of a field that is annotated with `Literal`.

    Args:
        value: One of them, or None if that is allowed.
        key: Key of the node in its parent.
        choices: What it may be.
        optional: Whether None is allowed.
    """

    def __init__(
        self,
        value: Any = None,
        key: Any = None,
        choices: tuple[Any, ...] = (),
        optional: bool = True,
    ) -> None:
        self.__dict__["choices"] = choices
        metadata = Metadata(ref_type=str, object_type=str, optional=optional, key=key)
        super().__init__(parent=None, value=value, metadata=metadata)

    def _validate_and_convert_impl(self, value: Any) -> Any:
        value = _plain(value)
        for choice in self.__dict__["choices"]:
            # 1 equals True, and is another choice.
            if type(choice) is type(value) and choice == value:
                return choice
        hint = nearest(str(value), map(str, self.__dict__["choices"]))
        raise ValidationError(f"'{value}' is no choice; {hint}")

    def __deepcopy__(self, memo: dict[int, Any]) -> ChoiceNode:
        copy = type(self)(choices=self.__dict__["choices"])
        self._deepcopy_impl(copy, memo)
        return copy


def _plain(value: Any) -> Any:
    if OmegaConf.is_config(value):
        return OmegaConf.to_container(value)
    return value._value() if isinstance(value, Node) else value
