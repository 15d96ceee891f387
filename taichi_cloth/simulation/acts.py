"""Acts on a simulation from outside, told to who listens, so that they can be done again."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import wraps
from typing import Any, TypeVar, cast

from taichi_cloth.errors import InputError

Method = TypeVar("Method", bound=Callable[..., Any])


class Listener:
    """A listener to a run: it is told of each act, and of each frame after it was made.

    It changes nothing of the simulation, and keeps no argument: some are written to later. What it
    does not care for it leaves as it is here.
    """

    def before_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """A method of the simulation is called with these arguments; it may still refuse them."""

    def after_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """It was called, and did what it was asked for."""

    def act_refused(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """It did not, although this one let it: it, or who was asked after this one, refused."""

    def after_frame(self) -> None:
        """A frame was made, and the state is that of its end. An interrupt waits until all know."""

    def between_frames(self) -> None:
        """All know of the last frame: here is time for what takes long, which interrupts end."""


def act(method: Method) -> Method:
    """A method of a `Part` that acts on the state, told to the listeners and noted in its past.

    Acts that it does itself are a part of it, and not told.
    """

    @wraps(method)
    def told(self: Any, *args: Any, **given: Any) -> Any:
        listeners, past = self.listeners, self.past
        if not listeners and past is None:
            return method(self, *args, **given)
        asked: list[Listener] = []
        try:
            for listener in listeners:
                listener.before_act(method.__name__, args, given)
                asked.append(listener)
            if past is not None:
                past.act(self.frame, method.__name__, args, given)
            self.listeners, self.past = (), None
            try:
                result = method(self, *args, **given)
            finally:
                self.listeners, self.past = listeners, past
        except BaseException:
            for listener in asked:
                listener.act_refused(method.__name__, args, given)
            raise
        if past is not None:
            past.acted(self, method.__name__, args, given)
        for listener in listeners:
            listener.after_act(method.__name__, args, given)
        return result

    return cast(Method, told)


def noted(name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> bytes | None:
    """An act as bytes, since arguments may be written to later; None: it cannot be.

    That is a mistake of the caller's, which the act itself refuses.
    """
    with suppress(pickle.PicklingError, TypeError, AttributeError):
        return pickle.dumps((name, args, dict(given)), pickle.HIGHEST_PROTOCOL)
    return None


def do_again(sim: Any, act: bytes, but: Collection[str] = ()) -> None:
    """Do what `noted` made bytes of to a simulation, but for acts of some names.

    What the run refused is refused again.
    """
    name, args, given = pickle.loads(act)
    if name not in but:
        with suppress(InputError):
            getattr(sim, name)(*args, **given)
