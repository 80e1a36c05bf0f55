"""One gradient buffer for everything in a step that reads a hash grid's table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor


class SharedTable:
    """The table as several operations see it whose gradients are added up in one buffer.

    Autograd gets the buffer from the first operation of a backward pass, while later ones still add
    to it. Therefore nothing but operations that keep to `buffer` may use `table`: autograd would
    add the gradient of another use to the buffer out of place, and what is added to the buffer
    afterwards would be lost. For the same reason, an operation whose backward pass records a graph
    (`create_graph=True`) adds nothing to the buffer and returns a gradient of its own.

    Attributes:
        table: The table, behind a node of the graph that all operations share. The node runs when
            all of them are done, and only then hands the finished buffer on.
    """

    def __init__(self, table: Float[Tensor, "entries 2"]) -> None:
        """Put the shared node on top of the table."""
        self._buffer: Tensor | None = None
        self._pass = -1
        self._source, self._version = table, table._version
        self.table = apply(_Share, table, self)

    def serves(self, table: Float[Tensor, "entries 2"]) -> bool:
        """Return whether this is still the given parameter: same memory, values and gradient."""
        # After a change in place autograd would give a view of the parameter another node, which
        # knows nothing of the buffer.
        return (
            self._source is table
            and self._version == table._version
            and self.table.data_ptr() == table.data_ptr()
            and self.table.requires_grad == table.requires_grad
        )

    def buffer(self) -> tuple[Tensor, bool]:
        """Return the buffer of this backward pass, and whether it is new.

        The operation that gets a new buffer must return it to autograd, and it alone: the others
        would make autograd add the buffer to itself.
        """
        # A pass that failed halfway has left its buffer behind, so each pass looks at its number.
        running = torch._C._current_graph_task_id()
        if self._buffer is not None and self._pass == running:
            return self._buffer, False
        self._buffer, self._pass = torch.zeros_like(self.table), running
        # A pass that asks for other gradients only (torch.autograd.grad) never reaches `_Share`,
        # and the next pass must not go on adding to its buffer.
        torch.autograd.Variable._execution_engine.queue_callback(self.forget)
        return self._buffer, True

    def forget(self) -> None:
        """Let go of the buffer, so that the next backward pass starts with a new one."""
        self._buffer = None


class _Share(torch.autograd.Function):
    """The identity, whose backward pass marks the end of all operations' additions."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, shared: SharedTable) -> Tensor:
        ctx.shared = shared
        # A new tensor: an input returned as it is would not get a node of its own.
        return table.view_as(table)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        ctx.shared.forget()
        return grads[0], None


def wanted(ctx: Any, argument: int) -> bool:
    """Return whether the running backward pass needs the gradient by an argument of an operation.

    `ctx.needs_input_grad` says whether any backward pass could need it. A pass for a few tensors
    (`torch.autograd.grad`) needs only what leads to those.

    Args:
        ctx: Autograd's context of the operation.
        argument: Position among the operation's arguments, of which tensors come first. The tensor
            must not be a leaf of the graph.
    """
    return bool(
        ctx.needs_input_grad[argument]
        and torch._C._will_engine_execute_node(ctx.next_functions[argument][0])
    )


def apply(operation: type[torch.autograd.Function], *arguments: Any) -> Tensor:
    """Call an operation of autograd that returns one tensor, which torch leaves without types."""
    call: Callable[..., Tensor] = operation.apply
    return call(*arguments)
