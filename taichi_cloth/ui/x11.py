"""A second look at our own window on X11, for what Taichi's windows do not report.

GGUI says of a button's press neither where nor in which order with keys it came, drops the keys
``. + - =`` and F1, and knows no wheel; ti.GUI cannot tell a key that repeats from one that is
pressed again, and does not follow a resize; neither says that another
window has the keyboard; and where the connection of either is cut, Xlib ends the process. On X11 a
second connection may look at the same window, Xlib shows every event that it reads for the window's
own (`XESetWireToEvent`), and lets that survive its end. Everywhere else `connect` returns None, and
what Taichi reports must do.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import os
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from taichi_cloth.errors import RunFailure

KEY_PRESS, KEY_RELEASE, BUTTON_PRESS, BUTTON_RELEASE, MOTION = 2, 3, 4, 5, 6
KINDS = {
    KEY_PRESS: "press",
    KEY_RELEASE: "release",
    BUTTON_PRESS: "press",
    BUTTON_RELEASE: "release",
    MOTION: "move",
}

ENTER, LEAVE, FOCUS_OUT = 7, 8, 10  # as these masks ask for them
BORDER_MASK, FOCUS_MASK = 1 << 4 | 1 << 5, 1 << 21
EVENT_BYTES = 192  # of any event

PICTURE_BYTES = 4 << 20  # of 1280 x 800 pixels; the system may allow less

_pointer, _window, _int = ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int


class ConnectionCut(RunFailure):
    """The window went because its connection to the display was cut, or the display ended."""

    def __init__(self) -> None:
        super().__init__(
            "the window's connection to the display was cut; its files hold the run until then"
        )


class WindowDestroyed(RunFailure):
    """Another program destroyed the window while Vulkan drew in it: the run ends as if closed."""

    exit_status = 0

    def __init__(self) -> None:
        super().__init__("the window was destroyed; its files hold the run until then")


@dataclass(frozen=True)
class Input:
    """One thing the user did in the window, as X says it.

    kind: "press", "release" or "move". pos: (x, y) in window pixels, where the pointer was then.
    button: X's number (4 and 5 are the wheel's); 0 for a key or a motion.
    keys: X's names of the key: by the layout in use, and by the first one; () for a button.
    """

    kind: str
    pos: tuple[float, float]
    button: int = 0
    keys: tuple[str, ...] = ()


class _Event(ctypes.Structure):
    """X's event of a key, a button or the pointer; detail: keycode or button."""

    _fields_ = [
        ("type", _int),
        ("serial", ctypes.c_ulong),
        ("send_event", _int),
        ("display", _pointer),
        ("window", _window),
        ("root", _window),
        ("subwindow", _window),
        ("time", ctypes.c_ulong),
        ("x", _int),
        ("y", _int),
        ("x_root", _int),
        ("y_root", _int),
        ("state", ctypes.c_uint),
        ("detail", ctypes.c_uint),
        ("same_screen", _int),
    ]


class _Error(ctypes.Structure):
    _fields_ = [
        ("type", _int),
        ("display", _pointer),
        ("resource", ctypes.c_ulong),
        ("serial", ctypes.c_ulong),
        ("code", ctypes.c_ubyte),
    ]


_AFTER_READING = 1  # asks how many events wait, with those that the server has sent by now
_BYTES, _REPLACE = 8, 0  # of a property: bits in each of its items; what becomes of it before
BAD_WINDOW, BAD_DRAWABLE = 3, 9
_ErrorHandler = ctypes.CFUNCTYPE(_int, _pointer, _pointer)
_OfDisplay = ctypes.CFUNCTYPE(_int, _pointer)
_ExitHandler = ctypes.CFUNCTYPE(None, _pointer, _pointer)
_Converter = ctypes.CFUNCTYPE(_int, _pointer, _pointer, _pointer)

# Xlib keeps the addresses of these for the life of the process, or of a connection.
_KEPT_HANDLERS: list[object] = []
_SURVIVING: set[int] = set()  # connections whose end the process survives
_CUT: set[int] = set()  # connections that broke: nothing may be asked of them any more


def xlib() -> ctypes.CDLL | None:
    """Xlib with the signatures used here, or None where it is not installed."""
    if not sys.platform.startswith(("linux", "freebsd")):
        return None
    try:
        x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    except OSError:
        return None
    by = ctypes.POINTER
    for name, result, arguments in (
        ("XOpenDisplay", _pointer, [ctypes.c_char_p]),
        ("XCloseDisplay", _int, [_pointer]),
        ("XDefaultRootWindow", _window, [_pointer]),
        ("XResourceManagerString", ctypes.c_char_p, [_pointer]),
        ("XKeysymToKeycode", ctypes.c_ubyte, [_pointer, _window]),
        ("XGetPointerMapping", _int, [_pointer, _pointer, _int]),
        ("XQueryTree", _int, [_pointer, _window] + [_pointer] * 4),
        ("XFetchName", _int, [_pointer, _window, by(ctypes.c_char_p)]),
        ("XFree", _int, [_pointer]),
        ("XLookupString", _int, [_pointer, ctypes.c_char_p, _int, by(_window), _pointer]),
        ("XkbKeycodeToKeysym", _window, [_pointer, ctypes.c_uint, _int, _int]),
        ("XKeysymToString", ctypes.c_char_p, [_window]),
        ("XSync", _int, [_pointer, _int]),
        ("XConnectionNumber", _int, [_pointer]),
        ("XGetGeometry", _int, [_pointer, _window] + [_pointer] * 7),
        ("XMoveWindow", _int, [_pointer, _window, _int, _int]),
        ("XStoreName", _int, [_pointer, _window, ctypes.c_char_p]),
        ("XInternAtom", _window, [_pointer, ctypes.c_char_p, _int]),
        (
            "XChangeProperty",
            _int,
            [_pointer, _window, _window, _window, _int, _int, ctypes.c_char_p, _int],
        ),
        ("XFlush", _int, [_pointer]),
        ("XSelectInput", _int, [_pointer, _window, ctypes.c_long]),
        ("XPending", _int, [_pointer]),
        ("XEventsQueued", _int, [_pointer, _int]),
        ("XkbSetDetectableAutoRepeat", _int, [_pointer, _int, _pointer]),
        ("XNextEvent", _int, [_pointer, _pointer]),
        ("XDefaultScreen", _int, [_pointer]),
        ("XDisplayWidth", _int, [_pointer, _int]),
        ("XDisplayHeight", _int, [_pointer, _int]),
        ("XTranslateCoordinates", _int, [_pointer, _window, _window, _int, _int] + [_pointer] * 3),
        ("XSetErrorHandler", _pointer, [_pointer]),
        ("XSetIOErrorHandler", _pointer, [_pointer]),
        ("XESetWireToEvent", _pointer, [_pointer, _int, _pointer]),
    ):
        function = getattr(x, name)
        function.restype, function.argtypes = result, arguments
    return x


@contextlib.contextmanager
def opening() -> Iterator[list[int]]:
    """Takes note of the connections to displays that are opened meanwhile: a window's own.

    Taichi does not say which it uses; Xlib calls a function for each that it opens.
    """
    opened: list[int] = []
    x = xlib() if os.environ.get("DISPLAY") else None
    if x is None:
        yield opened
        return
    with (
        _noting(x, "_XInitDisplayLock_fn", opened.append),
        _noting(x, "_XFreeDisplayLock_fn", opened.remove),  # a driver looks and closes again
    ):
        yield opened


@contextlib.contextmanager
def _noting(x: ctypes.CDLL, name: str, note: Callable[[int], None]) -> Iterator[None]:
    """Have Xlib's function of this name, which takes a connection, call `note` besides."""
    try:
        slot = _pointer.in_dll(x, name)
    except ValueError:  # an Xlib that has none
        yield
        return
    before = slot.value
    call = _OfDisplay(before) if before else None

    def call_both(display: int) -> int:
        with contextlib.suppress(ValueError):  # closed, and opened before
            note(display)
        return call(display) if call else 0

    both = _OfDisplay(call_both)
    slot.value = ctypes.cast(both, _pointer).value
    try:
        yield
    finally:
        slot.value = before


def _survive(x: ctypes.CDLL, display: int) -> None:
    """Let the process go on where this connection breaks. Xlib 1.7 or later can."""
    if not hasattr(x, "XSetIOErrorExitHandler"):
        return

    def ended(display: int, _: int | None) -> None:
        _CUT.add(display)

    go_on = _ExitHandler(ended)
    x.XSetIOErrorExitHandler.argtypes = [_pointer, _pointer, _pointer]
    x.XSetIOErrorExitHandler(display, go_on, None)
    _KEPT_HANDLERS.append(go_on)
    _SURVIVING.add(display)


def _widen(x: ctypes.CDLL, display: int) -> None:
    """Let a whole picture wait in the connection: drawn in software, each goes through it, and
    else we would wait until the server has read it (0.7 ms of 5 at 1280 x 800).
    """
    with (
        contextlib.suppress(OSError),
        socket.socket(fileno=os.dup(x.XConnectionNumber(display))) as s,
    ):
        s.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, PICTURE_BYTES)


def keep(window: object) -> None:
    """Never give this window back: it is gone, and drivers would end the process."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(window))


def _install_end_handler(x: ctypes.CDLL) -> None:
    """Say nothing where a connection breaks that is survived: we say it ourselves."""
    before: list[Callable[[int], int]] = []

    def handle(display: int) -> int:
        return 0 if display in _SURVIVING or not before else before[0](display)

    handler = _OfDisplay(handle)
    address = x.XSetIOErrorHandler(handler)
    if address:
        before.append(_OfDisplay(address))
    _KEPT_HANDLERS.append(handler)


class Connection:
    """Our own window, seen over a second connection to the X server.

    title: the window's exact name at the time (it may change afterwards).
    displays: the window's own connections, from `opening`.
    """

    def __init__(self, x: ctypes.CDLL, title: str, displays: list[int]):
        self._x, self._displays = x, displays
        self._display = x.XOpenDisplay(None)
        if not self._display:
            raise OSError("the X display cannot be opened")
        self._install_error_handler()
        _install_end_handler(x)
        for display in (self._display, *displays):
            _survive(x, display)
        for display in displays:
            _widen(x, display)
        self._root = x.XDefaultRootWindow(self._display)
        self.window = self._find(self._root, title.encode(), 0)
        self._read: list[_Event] = []
        self._leaves = False  # whether the pointer went out of the window, and nobody was told
        self._stop: KeyboardInterrupt | None = None  # an interrupt that came as Xlib read events
        if not self.window:
            self.close()
            raise OSError(f"no window is called {title!r}")
        x.XSelectInput(
            self._display, self.window, BORDER_MASK | FOCUS_MASK
        )  # ti.GUI asks for no such event
        x.XSync(self._display, 0)

    def listen(self) -> bool:
        """Begin to take note of `inputs`; whether that can be done."""
        for display in self._displays:
            self._x.XkbSetDetectableAutoRepeat(display, 1, None)  # a key is let go only once
            self._listen(display)
        return bool(self._displays)

    def _install_error_handler(self) -> None:
        """Ignore errors of this connection, and everybody's where a window was destroyed.

        Xlib's own handler would end the process before its files are saved.
        """
        ours = self._display
        before: list[Callable[[int | None, int], int]] = []

        def handle(display: int | None, event: int) -> int:
            error = ctypes.cast(event, ctypes.POINTER(_Error))[0].code
            if display == ours or not before or error in (BAD_WINDOW, BAD_DRAWABLE):
                return 0
            return before[0](display, event)

        handler = _ErrorHandler(handle)
        address = self._x.XSetErrorHandler(handler)
        if address:
            before.append(_ErrorHandler(address))
        _KEPT_HANDLERS.append(handler)

    def _children(self, window: int) -> list[int]:
        root, parent = _window(), _window()
        children, count = ctypes.POINTER(_window)(), ctypes.c_uint()
        out = [ctypes.byref(v) for v in (root, parent, children, count)]
        if not self._x.XQueryTree(self._display, window, *out) or not count.value:
            return []
        found = [children[i] for i in range(count.value)]
        self._x.XFree(children)
        return found

    def _find(self, window: int, title: bytes, depth: int) -> int:
        name = ctypes.c_char_p()
        if self._x.XFetchName(self._display, window, ctypes.byref(name)) and name.value == title:
            return window
        if depth < 5:  # a window manager adds a frame or two, never this many
            for child in self._children(window):
                found = self._find(child, title, depth + 1)
                if found:
                    return found
        return 0

    def _listen(self, display: int) -> None:
        """Take note of the user's events as Xlib reads them for the window itself."""
        for kind in KINDS:
            before: list[Callable[[int, int, int], int]] = []

            def convert(
                display: int,
                event: int,
                wire: int,
                before: list[Callable[[int, int, int], int]] = before,
            ) -> int:
                try:
                    converted = before[0](display, event, wire)
                    self._read.append(_Event.from_buffer_copy(ctypes.string_at(event, _SIZE)))
                    return converted
                except KeyboardInterrupt as stop:  # which Xlib, in between, would swallow
                    self._stop = stop
                    return 0

            converter = _Converter(convert)
            address = self._x.XESetWireToEvent(display, kind, converter)
            before.append(_Converter(address))
            _KEPT_HANDLERS.append(converter)

    def inputs(self) -> list[Input]:
        """The user's inputs since the last call, oldest first.

        The window itself finds all of it, too. An interrupt that came meanwhile is raised here.
        """
        for display in () if self._is_broken() else self._displays:
            self._x.XEventsQueued(display, _AFTER_READING)
        stop, self._stop = self._stop, None
        if stop:
            raise stop
        read, self._read = self._read, []
        return [self._input(event) for event in read if event.window == self.window]

    def lost_focus(self) -> bool:
        """True if another window got the keyboard since the last call, be it for a moment.

        Keys that were down then are let go where we do not see it. It also looks where the
        pointer goes (`leaves`).
        """
        lost, event = False, ctypes.create_string_buffer(EVENT_BYTES)
        while not self._is_broken() and self._x.XPending(self._display):
            self._x.XNextEvent(self._display, event)
            kind = _int.from_buffer(event).value
            lost = lost or kind == FOCUS_OUT
            self._leaves = kind == LEAVE or (self._leaves and kind != ENTER)
        return lost

    def leaves(self) -> bool:
        """True if the pointer left the window since the last call; `lost_focus` looks."""
        leaves, self._leaves = self._leaves, False
        return leaves

    def _is_broken(self) -> bool:
        return bool(_CUT.intersection((self._display, *self._displays)))

    def _input(self, event: _Event) -> Input:
        kind, pos = KINDS[event.type], (float(event.x), float(event.y))
        if event.type == MOTION:
            return Input(kind, pos)
        if event.type in (BUTTON_PRESS, BUTTON_RELEASE):
            return Input(kind, pos, button=event.detail)
        symbol, text = _window(), ctypes.create_string_buffer(8)
        event.display = self._display
        self._x.XLookupString(ctypes.byref(event), text, 8, ctypes.byref(symbol), None)
        first = self._x.XkbKeycodeToKeysym(self._display, event.detail, 0, 0)
        names = [self._x.XKeysymToString(one) for one in (symbol.value, first)]
        return Input(kind, pos, keys=tuple(name.decode() for name in names if name))

    def size(self) -> tuple[int, int] | None:
        """The window's (width, height) in pixels; None when it is gone."""
        if self._is_broken():
            return None
        return self._size(self.window)

    def _size(self, window: int) -> tuple[int, int] | None:
        root, x, y = _window(), _int(), _int()
        w, h, border, depth = (ctypes.c_uint() for _ in range(4))
        out = [ctypes.byref(v) for v in (root, x, y, w, h, border, depth)]
        if not self._x.XGetGeometry(self._display, window, *out):
            return None
        return w.value, h.value

    def is_gone(self) -> bool:
        """True if the window no longer exists (closing it by its frame only asks it to go)."""
        return self.size() is None

    def is_cut(self) -> bool:
        """True if the window is gone because its connection was cut, or the display ended."""
        for display in (self._display, *self._displays):
            if display not in _CUT:
                self._x.XSync(display, 0)
        return self._is_broken()

    def position(self) -> tuple[int, int]:
        """The window's top left corner on the screen."""
        x, y, child = _int(), _int(), _window()
        out = [ctypes.byref(v) for v in (x, y, child)]
        self._x.XTranslateCoordinates(self._display, self.window, self._root, 0, 0, *out)
        return x.value, y.value

    def move(self, position: tuple[int, int]) -> None:
        """Put the window's top left corner at `position` on the screen."""
        self._x.XMoveWindow(self._display, self.window, *position)
        self._x.XSync(self._display, 0)

    def show_whole(self) -> None:
        """Move the window so far that all of it is on the screen, or its top left corner."""
        size, screen, position = self.size(), self._size(self._root), self.position()
        if size and screen:
            ends = zip(position, screen, size, strict=True)
            x, y = (max(0, min(at, whole - part)) for at, whole, part in ends)
            if (x, y) != position:
                self.move((x, y))

    def entitle(self, title: str) -> None:
        """Write another title over the window."""
        if not self._is_broken():
            words = title.encode()
            self._x.XStoreName(self._display, self.window, words)
            name, utf8 = (
                self._x.XInternAtom(self._display, atom, 0)
                for atom in (b"_NET_WM_NAME", b"UTF8_STRING")
            )
            what = (name, utf8, _BYTES, _REPLACE, words, len(words))
            self._x.XChangeProperty(self._display, self.window, *what)
            self._x.XFlush(self._display)

    def close(self) -> None:
        """Give the connection back, unless it is cut. May be called twice."""
        if self._display and self._display not in _CUT:
            self._x.XCloseDisplay(self._display)
            self._display = None


_SIZE = ctypes.sizeof(_Event)


def connect(title: str, displays: list[int]) -> Connection | None:
    """The window called `title` over X11, or None where that cannot be had.

    displays: its own connections, from `opening`.
    """
    x = xlib()
    if x is None or not os.environ.get("DISPLAY"):
        return None
    try:
        return Connection(x, title, displays)
    except OSError:
        return None
