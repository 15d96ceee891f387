"""Which Vulkan devices there are, asked without Taichi."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
import subprocess
import sys

SOFTWARE = re.compile("llvmpipe|lavapipe|swiftshader|softpipe|basic render", re.I)


def is_software(device: str) -> bool:
    """True if a device is a program on the processor, by its name."""
    return bool(SOFTWARE.search(device))


def device_name() -> str | None:
    """Name of the first Vulkan device, or None. Asked in a process of its own: drivers crash."""
    code = "from taichi_cloth import vulkan; print(next(iter(vulkan.devices()), ''))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    try:
        answer = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=20,
            env=environment,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip() or None


def devices() -> list[str]:
    """Names of the Vulkan devices, in the loader's order; none without a loader."""
    names = {"win32": "vulkan-1.dll", "darwin": "libvulkan.dylib"}
    library = ctypes.util.find_library("vulkan") or names.get(sys.platform, "libvulkan.so.1")
    try:
        vulkan = ctypes.CDLL(library)
    except OSError:
        return []

    class InstanceCreateInfo(ctypes.Structure):
        _fields_ = [  # noqa: RUF012
            ("type", ctypes.c_int32),
            ("next", ctypes.c_void_p),
            ("flags", ctypes.c_uint32),
            ("application", ctypes.c_void_p),
            ("layer_count", ctypes.c_uint32),
            ("layers", ctypes.c_void_p),
            ("extension_count", ctypes.c_uint32),
            ("extensions", ctypes.c_void_p),
        ]

    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO is 1; VK_SUCCESS is 0, VK_INCOMPLETE 5.
    create = InstanceCreateInfo(type=1)
    if vulkan.vkCreateInstance(ctypes.byref(create), None, ctypes.byref(instance)) != 0:
        return []
    try:
        enumerate_devices = vulkan.vkEnumeratePhysicalDevices
        if enumerate_devices(instance, ctypes.byref(count), None) != 0 or not count.value:
            return []
        found = (ctypes.c_void_p * count.value)()
        if enumerate_devices(instance, ctypes.byref(count), found) not in (0, 5):
            return []
        listed = []
        for device in found[: count.value]:
            # VkPhysicalDeviceProperties, 824 bytes: five 32-bit numbers, then the name (256 bytes).
            properties = ctypes.create_string_buffer(2048)
            vulkan.vkGetPhysicalDeviceProperties(ctypes.c_void_p(device), properties)
            listed.append(properties.raw[20:276].split(b"\0")[0].decode("utf-8", "replace"))
        return listed
    finally:
        vulkan.vkDestroyInstance(instance, None)
