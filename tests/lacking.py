"""What a machine may lack that a test needs. Where CI is set nothing may be missing.

`.ci/run` installs all of it and sets CI, so that nothing is skipped there: what is missing fails.
"""

import importlib.util
import os
import shutil

import pytest

from taichi_cloth import runtime

IN_CI = bool(os.environ.get("CI"))


def needs(there, what):
    """A mark: skipped where `what` is not there, unless in CI."""
    return pytest.mark.skipif(not (there or IN_CI), reason=f"needs {what}")


# Windows need a server and something that presses keys.
needs_x = needs(shutil.which("Xvfb") and shutil.which("xdotool"), "Xvfb and xdotool")
needs_vulkan = needs(runtime.vulkan_available(), "Vulkan")
needs_compiler = needs(shutil.which("g++"), "g++")
needs_peers = needs(importlib.util.find_spec("newton"), 'pip install -e ".[bench]"')
needs_mkdocs = needs(importlib.util.find_spec("mkdocstrings"), 'pip install -e ".[docs]"')

# The views as a test's parameters: only one of them can be without Vulkan.
VIEWS = [pytest.param("ggui", marks=needs_vulkan), "gui"]
