"""The kinds of capture, on which defaults depend, and what a name of them stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxtyping import Float
from torch import Tensor

from nerfreg.scenes.splits import evenly

FORWARD, OBJECT, ROOM = "forward", "object", "room"
KINDS = {
    FORWARD: "photographs side by side",
    OBJECT: "photographs around an object with nothing behind it",
    ROOM: "opaque photographs around a place",
}
"""The three kinds of capture, and what each of them is."""
ORBIT = "orbit"
"""Either kind whose cameras stand around what they show: an object where silhouettes are known, a
room where they are not. In earlier versions this was one layout."""
LAYOUTS = (*KINDS, ORBIT)
"""What `scene.layout` and the keys of `Regularizer.by_layout` may be."""
LOOKED_AT = 4
"""Most images that are searched for a transparent pixel."""


def stands_around(layout: str) -> bool:
    """Whether the cameras of a kind of capture stand around what they show."""
    return layout != FORWARD


def defaults_of(layout: str | None, by_layout: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the defaults that differ for a kind of capture.

    Args:
        layout: The kind. An orbit of which no more is known is taken for one of an object; for None
            and unknown names nothing differs.
        by_layout: Defaults by kind. Those of "orbit" hold for objects and rooms, unless the kind
            itself has others.

    Returns:
        Defaults by key.
    """
    if layout in (OBJECT, ROOM, ORBIT):
        kind = ROOM if layout == ROOM else OBJECT
        return {**by_layout.get(ORBIT, {}), **by_layout.get(kind, {})}
    return {**by_layout.get(layout or "", {})}


def kind_of_orbit(
    has_alpha: bool,
    views: Sequence[int],
    read_image: Callable[[int], Float[Tensor, "height width channels"]],
) -> str:
    """Tell an object from a room.

    Args:
        has_alpha: Whether the images have an alpha channel.
        views: The training views.
        read_image: Reads the image of a view; it is not called if there is no alpha channel.

    Returns:
        "object" if the images show silhouettes, else "room".
    """
    # A header does not tell whether anything is transparent: many programs write an alpha channel
    # that is opaque everywhere, which shows no silhouette. One image is decoded where there are
    # silhouettes, since the first has one; a few more where it has none, since an object may fill
    # a picture that was taken close to it.
    some = evenly(views, min(LOOKED_AT, len(views))) if has_alpha else ()
    seen = any(bool((read_image(view)[..., 3] < 1).any()) for view in some)
    return OBJECT if seen else ROOM


def said(name: str, layout: str) -> str:
    """Return the line that says which kind of capture a scene was taken for."""
    others = " or ".join(kind for kind in KINDS if kind != layout)
    return f"{name}: {layout} ({KINDS[layout]}); scene.layout={others} overrides"
