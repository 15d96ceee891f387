"""What is done to a simulation from outside, told to who listens, so that it can be done again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

Method = TypeVar("Method", bound=Callable[..., Any])


class Listener(Protocol):
    """Who is told of a run: of each act before it is done, and of each frame after it was made.

    It changes nothing of the simulation, and keeps no argument: some are written to later.
    """

    def before_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """A method of the simulation is called with these arguments; it may still refuse them."""

    def after_frame(self) -> None:
        """A frame was made, and the state is that of its end."""


def act(method: Method) -> Method:
    """A method of a `Part` that acts on the state, told to the listener of its simulation, if any.

    Acts that it does itself are a part of it, and not told.
    """

    @wraps(method)
    def told(self: Any, *args: Any, **given: Any) -> Any:
        listener = self.listener
        if listener is None:
            return method(self, *args, **given)
        listener.before_act(method.__name__, args, given)
        self.listener = None
        try:
            return method(self, *args, **given)
        finally:
            self.listener = listener

    return cast(Method, told)
