"""What is done to a simulation from outside, told to who listens, so that it can be done again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar, cast

Method = TypeVar("Method", bound=Callable[..., Any])


class Listener:
    """Who is told of a run: of each act, and of each frame after it was made.

    It changes nothing of the simulation, and keeps no argument: some are written to later. What it
    does not care for it leaves as it is here.
    """

    def before_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """A method of the simulation is called with these arguments; it may still refuse them."""

    def after_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """It was called, and did what it was asked for."""

    def after_frame(self) -> None:
        """A frame was made, and the state is that of its end."""


def act(method: Method) -> Method:
    """A method of a `Part` that acts on the state, told to the listeners of its simulation.

    Acts that it does itself are a part of it, and not told.
    """

    @wraps(method)
    def told(self: Any, *args: Any, **given: Any) -> Any:
        listeners = self.listeners
        if not listeners:
            return method(self, *args, **given)
        for listener in listeners:
            listener.before_act(method.__name__, args, given)
        self.listeners = ()
        try:
            result = method(self, *args, **given)
        finally:
            self.listeners = listeners
        for listener in listeners:
            listener.after_act(method.__name__, args, given)
        return result

    return cast(Method, told)
