"""A second look at our own window on X11, for what Taichi's windows do not report.

GGUI drops the keys ``. + - =`` and F1 and knows no wheel; ti.GUI does not follow a resize. On
X11 a second connection may listen to the same window: keys through a second event selection,
the wheel through raw input events, the size by asking. Everywhere else `connect` returns None
and the always-arriving keys (arrows, tab) stand in.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Callable

KEY_PRESS, KEY_RELEASE, GENERIC = 2, 3, 35
KEY_PRESS_MASK, KEY_RELEASE_MASK = 1, 2
RAW_BUTTON_PRESS, ALL_MASTER_DEVICES = 15, 1
KEYS = {  # X's names of the keys that GGUI drops -> ours
    "period": ".",
    "KP_Decimal": ".",
    "plus": "+",
    "equal": "+",
    "KP_Add": "+",
    "minus": "-",
    "KP_Subtract": "-",
    "F1": "f1",
}
WHEEL = {4: 1.0, 5: -1.0}  # X's button numbers of the wheel -> notches away from the user

_pointer, _window, _int = ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int


_HEAD = (  # what every event of X begins with
    ("type", _int),
    ("serial", ctypes.c_ulong),
    ("send_event", _int),
    ("display", _pointer),
)


class _KeyEvent(ctypes.Structure):
    _fields_ = [
        *_HEAD,
        ("window", _window),
        ("root", _window),
        ("subwindow", _window),
        ("time", ctypes.c_ulong),
        ("x", _int),
        ("y", _int),
        ("x_root", _int),
        ("y_root", _int),
        ("state", ctypes.c_uint),
        ("keycode", ctypes.c_uint),
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


class _Cookie(ctypes.Structure):
    _fields_ = [
        *_HEAD,
        ("extension", _int),
        ("evtype", _int),
        ("cookie", ctypes.c_uint),
        ("data", _pointer),
    ]


class _RawEvent(ctypes.Structure):
    _fields_ = [
        *_HEAD,
        ("extension", _int),
        ("evtype", _int),
        ("time", ctypes.c_ulong),
        ("deviceid", _int),
        ("sourceid", _int),
        ("detail", _int),
    ]


class _Event(ctypes.Union):
    _fields_ = [
        ("type", _int),
        ("key", _KeyEvent),
        ("cookie", _Cookie),
        ("pad", ctypes.c_long * 24),
    ]


class _EventMask(ctypes.Structure):
    _fields_ = [("deviceid", _int), ("mask_len", _int), ("mask", ctypes.c_char_p)]


BAD_WINDOW, BAD_DRAWABLE = 3, 9
_ErrorHandler = ctypes.CFUNCTYPE(_int, _pointer, _pointer)


def _library(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(ctypes.util.find_library(name) or f"lib{name}.so.6")
    except OSError:
        return None


def _xlib() -> ctypes.CDLL | None:
    """Xlib with the signatures used here, or None where it is not installed."""
    x = _library("X11") if sys.platform.startswith(("linux", "freebsd")) else None
    if x is None:
        return None
    by = ctypes.POINTER
    for name, result, arguments in (
        ("XOpenDisplay", _pointer, [ctypes.c_char_p]),
        ("XCloseDisplay", _int, [_pointer]),
        ("XDefaultRootWindow", _window, [_pointer]),
        ("XQueryTree", _int, [_pointer, _window] + [_pointer] * 4),
        ("XFetchName", _int, [_pointer, _window, by(ctypes.c_char_p)]),
        ("XFree", _int, [_pointer]),
        ("XSelectInput", _int, [_pointer, _window, ctypes.c_long]),
        ("XPending", _int, [_pointer]),
        ("XNextEvent", _int, [_pointer, _pointer]),
        ("XLookupString", _int, [_pointer, ctypes.c_char_p, _int, by(_window), _pointer]),
        ("XKeysymToString", ctypes.c_char_p, [_window]),
        ("XSync", _int, [_pointer, _int]),
        ("XGetGeometry", _int, [_pointer, _window] + [_pointer] * 7),
        ("XMoveWindow", _int, [_pointer, _window, _int, _int]),
        ("XTranslateCoordinates", _int, [_pointer, _window, _window, _int, _int] + [_pointer] * 3),
        ("XQueryPointer", _int, [_pointer, _window] + [_pointer] * 7),
        ("XQueryExtension", _int, [_pointer, ctypes.c_char_p] + [_pointer] * 3),
        ("XGetEventData", _int, [_pointer, _pointer]),
        ("XFreeEventData", None, [_pointer, _pointer]),
        ("XkbSetDetectableAutoRepeat", _int, [_pointer, _int, _pointer]),
        ("XSetErrorHandler", _pointer, [_pointer]),
    ):
        function = getattr(x, name)
        function.restype, function.argtypes = result, arguments
    return x


class Connection:
    """Our own window, seen over a second connection to the X server.

    title: the window's exact name at the time (it may change afterwards).
    """

    def __init__(self, x: ctypes.CDLL, title: str, *, keys: bool):
        self._x = x
        self._display = x.XOpenDisplay(None)
        if not self._display:
            raise OSError("the X display cannot be opened")
        self._install_error_handler()
        self._root = x.XDefaultRootWindow(self._display)
        self.window = self._find(self._root, title.encode(), 0)
        self.has_wheel, self._opcode = False, -1
        if not self.window:
            self.close()
            raise OSError(f"no window is called {title!r}")
        if keys:
            x.XSelectInput(self._display, self.window, KEY_PRESS_MASK | KEY_RELEASE_MASK)
            x.XkbSetDetectableAutoRepeat(self._display, 1, None)
            self.has_wheel = self._select_wheel()
        x.XSync(self._display, 0)

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

    def _select_wheel(self) -> bool:
        """Ask for raw button presses (the window itself keeps the ordinary ones to itself)."""
        xi = _library("Xi")
        opcode, a, b = _int(), _int(), _int()
        refs = [ctypes.byref(v) for v in (opcode, a, b)]
        if xi is None or not self._x.XQueryExtension(self._display, b"XInputExtension", *refs):
            return False
        major, minor = _int(2), _int(2)
        xi.XIQueryVersion.argtypes = [_pointer, _pointer, _pointer]
        if xi.XIQueryVersion(self._display, ctypes.byref(major), ctypes.byref(minor)) != 0:
            return False
        bits = bytearray(4)
        bits[RAW_BUTTON_PRESS >> 3] |= 1 << (RAW_BUTTON_PRESS & 7)
        mask = _EventMask(ALL_MASTER_DEVICES, len(bits), bytes(bits))
        xi.XISelectEvents.argtypes = [_pointer, _window, _pointer, _int]
        self._opcode = opcode.value
        status: int = xi.XISelectEvents(self._display, self._root, ctypes.byref(mask), 1)
        return status == 0

    def _pointer_is_here(self) -> bool:
        """Whether the pointer is over our window with nothing in front of it."""
        window = self._root
        for _ in range(8):
            root, child = _window(), _window()
            rest = [_int() for _ in range(4)]
            state = ctypes.c_uint()
            out = [ctypes.byref(v) for v in (root, child, *rest, state)]
            self._x.XQueryPointer(self._display, window, *out)
            if child.value in (0, self.window):
                return child.value == self.window
            window = child.value
        return False

    def poll(self) -> list[tuple[str, str | float]]:
        """What happened since the last call: ("press"|"release", key) and ("wheel", notches)."""
        out: list[tuple[str, str | float]] = []
        event = _Event()
        while self._x.XPending(self._display):
            self._x.XNextEvent(self._display, ctypes.byref(event))
            if event.type in (KEY_PRESS, KEY_RELEASE):
                symbol, text = _window(), ctypes.create_string_buffer(8)
                self._x.XLookupString(ctypes.byref(event), text, 8, ctypes.byref(symbol), None)
                name = self._x.XKeysymToString(symbol.value)
                key = KEYS.get(name.decode()) if name else None
                if key:
                    out.append(("press" if event.type == KEY_PRESS else "release", key))
            elif (
                event.type == GENERIC
                and event.cookie.extension == self._opcode
                and self._x.XGetEventData(self._display, ctypes.byref(event.cookie))
            ):
                raw = ctypes.cast(event.cookie.data, ctypes.POINTER(_RawEvent))[0]
                if raw.detail in WHEEL and self._pointer_is_here():
                    out.append(("wheel", WHEEL[raw.detail]))
                self._x.XFreeEventData(self._display, ctypes.byref(event.cookie))
        return out

    def size(self) -> tuple[int, int] | None:
        """The window's (width, height) in pixels; None when it is gone."""
        root, x, y = _window(), _int(), _int()
        w, h, border, depth = (ctypes.c_uint() for _ in range(4))
        out = [ctypes.byref(v) for v in (root, x, y, w, h, border, depth)]
        if not self._x.XGetGeometry(self._display, self.window, *out):
            return None
        return w.value, h.value

    def is_gone(self) -> bool:
        """Whether the window no longer exists (closing it by its frame only asks it to go)."""
        return self.size() is None

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

    def close(self) -> None:
        """Give the connection back. May be called twice."""
        if self._display:
            self._x.XCloseDisplay(self._display)
            self._display = None


# Xlib keeps the address of the newest handler for the life of the process.
_KEPT_HANDLERS: list[object] = []


def connect(title: str, *, keys: bool) -> Connection | None:
    """The window called `title` over X11, or None where that cannot be had.

    keys: also listen to the keys and the wheel that GGUI does not report.
    """
    x = _xlib()
    if x is None or not os.environ.get("DISPLAY"):
        return None
    try:
        return Connection(x, title, keys=keys)
    except OSError:
        return None
