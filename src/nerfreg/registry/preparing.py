"""The hooks by which plugins look at a scene and choose cameras in it."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.hooks import Needs, Step
from nerfreg.registry.caller import PluginCaller
from nerfreg.scenes.scene import Photographs, SceneInfo


class PreparingHooks(PluginCaller):
    """What plugins know of the training views, and which rays they want."""

    @property
    def preparing(self) -> tuple[str, ...]:
        """Names of the plugins that look at the photographs first, which may take a while."""
        hooks = ("nerfreg_prepare", "nerfreg_known_depth")
        return tuple(dict.fromkeys(name for hook in hooks for name in self._users[hook]))

    def prepare(self, photographs: Photographs) -> dict[str, Tensor]:
        """Return what the selected plugins know of each training pixel, by "plugin.name".

        Each has a value, or several, for each pixel: (V, H, W, ...).

        Args:
            photographs: The training views.

        Raises:
            PluginError: An answer has no value for each pixel.
        """
        data = {}
        size = tuple(photographs.images.shape[:3])
        for plugin in self._users["nerfreg_prepare"]:
            for answer in self._ask("nerfreg_prepare", (plugin,), {"photographs": photographs}):
                if not isinstance(answer, dict):
                    wrong = f"returned {type(answer).__name__}; return a dictionary of tensors"
                    raise self._error("nerfreg_prepare", (plugin,), None, wrong)
                for name, values in answer.items():
                    if not isinstance(values, Tensor) or tuple(values.shape[:3]) != size:
                        found = (
                            f"has shape {tuple(values.shape)}"
                            if isinstance(values, Tensor)
                            else f"is of type {type(values).__name__}"
                        )
                        axes = ", ".join(map(str, size))
                        wrong = f"'{name}' {found}; return a tensor of shape ({axes}, ...)"
                        raise self._error("nerfreg_prepare", (plugin,), None, wrong)
                    data[f"{plugin}.{name}"] = values
        return data

    def known_depth(self, photographs: Photographs) -> Float[Tensor, "views height width 2"] | None:
        """Return what the selected plugins know of depth before training, whatever their windows.

        Args:
            photographs: The training views.

        Returns:
            An interval of distance for each pixel, NaN where nothing is known; None if no plugin
            answers. Of several plugins, it is the intersection of their intervals, or the narrower
            interval where these have nothing in common.

        Raises:
            PluginError: An answer is not an interval for each pixel.
        """
        known: Tensor | None = None
        for name in self._users["nerfreg_known_depth"]:
            for depth in self._ask("nerfreg_known_depth", (name,), {"photographs": photographs}):
                shape = (*photographs.images.shape[:3], 2)
                wrong = ""
                if not isinstance(depth, Tensor):
                    wrong = f"returned {type(depth).__name__}; return a tensor {shape}"
                elif tuple(depth.shape) != shape:
                    wrong = f"has shape {tuple(depth.shape)}, not {shape}"
                elif bool((depth[..., 0] > depth[..., 1]).any()):
                    wrong = "some intervals end before they begin"
                if wrong:
                    raise self._error("nerfreg_known_depth", (name,), None, wrong)
                known = depth if known is None else _agreed(known, depth)
        return known

    def needs(self, step: Step) -> Needs:
        """Return the union of what the active plugins want rendered.

        Raises:
            PluginError: An answer is something else.
        """
        union = Needs()
        for name in self._active("nerfreg_needs", step):
            for needs in self._ask("nerfreg_needs", (name,), {"step": step}):
                if not isinstance(needs, Needs):
                    wrong = f"returned {type(needs).__name__}; return Needs"
                    raise self._error("nerfreg_needs", (name,), step, wrong)
                self._patch_sides[name] = needs.patch_size
                union |= needs
        return union

    def unseen_poses(
        self, step: Step, scene: SceneInfo, count: int
    ) -> tuple[Float[Tensor, "count 3 4"], Int[Tensor, " count"]] | None:
        """Return poses of unseen cameras, and the training views whose intrinsics they have.

        Args:
            step: Where the run stands.
            scene: What is known of the scene.
            count: How many poses are needed.

        Returns:
            None if no active plugin chooses them.

        Raises:
            PluginError: An answer is not as many poses as were asked for.
        """
        active = self._active("nerfreg_unseen_poses", step)
        parts = []
        for place, name in enumerate(active):
            # Equal parts, of which the first ones take what is left over.
            share = len(range(place, count, len(active)))
            given = {"scene_info": scene, "count": share, "generator": step.generator}
            for answer in self._ask("nerfreg_unseen_poses", (name,), given):
                poses, views = answer if isinstance(answer, tuple) else (answer, None)
                if tuple(poses.shape) != (share, 3, 4):
                    wrong = f"returned poses of shape {tuple(poses.shape)}, not {(share, 3, 4)}"
                    raise self._error("nerfreg_unseen_poses", (name,), step, wrong)
                if views is None:
                    cameras = len(scene.cameras)
                    views = torch.randint(cameras, (share,), generator=step.generator)
                parts.append((poses, views))
        if not parts:
            return None
        poses, views = (torch.cat(column) for column in zip(*parts, strict=True))
        return poses, views


def _agreed(
    a: Float[Tensor, "*pixels 2"], b: Float[Tensor, "*pixels 2"]
) -> Float[Tensor, "*pixels 2"]:
    """Intersect intervals; take the narrower one where there is no intersection, or one is NaN."""
    # `fmax` and `fmin` ignore NaN.
    both = torch.stack([torch.fmax(a[..., 0], b[..., 0]), torch.fmin(a[..., 1], b[..., 1])], dim=-1)
    narrower = torch.where(a.diff(dim=-1) <= b.diff(dim=-1), a, b)
    return torch.where(both[..., :1] <= both[..., 1:], both, narrower)
