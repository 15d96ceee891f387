"""Screens for windows, where nobody looks."""

import contextlib
import os
import shutil
import subprocess
import time

import pytest
from lacking import IN_CI


@contextlib.contextmanager
def virtual_screen():
    """An X server of our own, as long as the context lasts; its name. CI must have Xvfb.

    A plain one, which starts anew whenever its last client leaves.
    """
    if not (shutil.which("Xvfb") or IN_CI):
        pytest.skip("needs Xvfb")
    read, write = os.pipe()
    screen = ["-screen", "0", "1400x900x24", "-nolisten", "tcp"]
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), *screen], pass_fds=[write], stderr=subprocess.DEVNULL
    )
    os.close(write)
    with os.fdopen(read) as said:
        number = said.readline().strip()
    _servers[f":{number}"] = server
    try:
        yield f":{number}"
    finally:
        server.terminate()
        server.wait()


_servers = {}  # by the names of their screens


def end_server(screen):
    """End a virtual screen at once, under the windows on it."""
    _servers[screen].kill()
    _servers[screen].wait()


def wait_for(seen, process, what, seconds=60):
    """What `seen()` returns, as soon as that is something; fails where the window's process ends.

    process: None where what is waited for has no window. seconds: after which it counts as hung:
    many times what a busy machine takes, as that is no measure of speed.
    """
    end = time.monotonic() + seconds
    while not (found := seen()):
        if process is not None:
            assert process.poll() is None, f"waiting for {what}: the window's process ended"
        if time.monotonic() > end:
            pytest.fail(f"waited {seconds} s in vain for {what}")
        time.sleep(0.05)
    return found
