"""The hooks that are called when a field is built."""

from __future__ import annotations

from torch import nn

from nerfreg.hooks import TrainedModule
from nerfreg.registry.caller import PluginCaller
from nerfreg.scenes.scene import SceneInfo


class BuildingHooks(PluginCaller):
    """What plugins put into a field, whatever their windows."""

    def encoder(self, which: str, scene: SceneInfo) -> nn.Module | None:
        """Return the encoder of a selected plugin, of "positions" or "directions", or None.

        Raises:
            PluginError: The encoder does not tell its width.
        """
        users = self._users["nerfreg_encoder"]
        if not users:
            return None
        given = {"which": which, "scene_info": scene}
        encoder: nn.Module | None = self._ask("nerfreg_encoder", users, given)
        if encoder is not None and not isinstance(getattr(encoder, "width", None), int):
            raise self._error(
                "nerfreg_encoder",
                users,
                None,
                f"the encoder of {which} has no attribute 'width'; set it to the number of its "
                "features, an integer",
            )
        return encoder

    def layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> nn.Module:
        """Return one layer of a network, made by a selected plugin whatever its window.

        See `HookSpecs.nerfreg_layer` for the arguments.
        """
        users = self._users["nerfreg_layer"]
        if not users:
            return self._core.nerfreg_layer(in_features, out_features, activation)
        given = {
            "network": network,
            "index": index,
            "in_features": in_features,
            "out_features": out_features,
            "activation": activation,
        }
        layer: nn.Module = self._ask("nerfreg_layer", users, given)
        return layer

    @property
    def color_inputs(self) -> int:
        """How many inputs of the colour network come from plugins."""
        return sum(self.plugins[name].color_inputs for name in self._users["nerfreg_color_input"])

    def modules(self, scene: SceneInfo, encoding_width: int) -> dict[str, TrainedModule]:
        """Return the modules of the selected plugins, by the names of the plugins.

        Args:
            scene: What is known of the scene.
            encoding_width: Number of features of an encoded position.

        Raises:
            PluginError: A plugin returned something else.
        """
        made = {}
        given = {"scene_info": scene, "encoding_width": encoding_width}
        for name in self._users["nerfreg_module"]:
            for part in self._ask("nerfreg_module", (name,), given):
                module = part.module if isinstance(part, TrainedModule) else part
                if not isinstance(module, nn.Module):
                    kind = f"returned {type(module).__name__}; return a torch module"
                    raise self._error("nerfreg_module", (name,), None, kind)
                made[name] = part if isinstance(part, TrainedModule) else TrainedModule(part)
        return made
