"""Full pools of descriptor sets in the driver's place: who is asked, and what is drawn."""

import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from lacking import needs_vulkan
from taichi._lib.core import taichi_python

from taichi_cloth import vulkan
from taichi_cloth.ui import descriptor_pools as pools


def test_the_driver_is_asked_but_for_the_first_set_after_a_full_pool():
    asked = []

    def driver(*given):
        asked.append(given)
        return 7

    call = pools._limited(driver)
    said = [call(1, 2, n) for n in range(3 * pools.LARGEST)]
    full = [n for n, result in enumerate(said) if result == pools.OUT_OF_POOL_MEMORY]
    assert full == [pools.LARGEST, 2 * pools.LARGEST + 1]
    assert asked == [(1, 2, n) for n in range(3 * pools.LARGEST) if n not in full]
    assert {said[n] for n in range(len(said)) if n not in full} == {7}


@pytest.mark.skipif(sys.platform != "linux", reason="reads ELF")
def test_symbols_are_found_in_a_library_or_refused(tmp_path):
    library = Path(taichi_python.__file__)
    assert pools.symbol(library, pools.POINTER) % 8 == 0
    with pytest.raises(ValueError, match="no one symbol of_nobody"):
        pools.symbol(library, b"of_nobody")
    wrong = tmp_path / "text.so"
    wrong.write_text("no library")
    with pytest.raises(ValueError, match="no library of 64 bits"):
        pools.symbol(wrong, b"main")


PICTURES = """
    import hashlib
    from taichi_cloth import runtime
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui import app, descriptor_pools
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view
    {own}
    real, full = descriptor_pools._limited, 0
    def watched(driver):
        call = real(driver)
        def counted(*given):
            global full
            result = call(*given)
            full += result == descriptor_pools.OUT_OF_POOL_MEMORY
            return result
        return counted
    descriptor_pools._limited = watched
    runtime.start()
    scene = library.build("box", particles=20)
    sim = Simulation(scene)
    view = open_view("none", scene.world, pictures=True, size=(160, 120), camera=camera_of(scene))
    for _ in range(150):
        sim.advance()
        print(hashlib.sha256(app.pixels_of(sim, view).tobytes()).hexdigest())
    print("full", full)
"""


@needs_vulkan
@pytest.mark.thorough
def test_pictures_stay_the_same_while_pools_are_given_back(tmp_path):
    def run(own):
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(PICTURES.format(own=own))],
            env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)}, cwd=tmp_path,
            capture_output=True, text=True, timeout=300, check=True,
        )  # fmt: skip
        *pictures, full = re.findall(r"^[0-9a-f]{64}$|^full .*$", done.stdout, re.M)
        return pictures, int(full.split()[1])

    ours, full = run("")
    theirs, never = run("descriptor_pools.limit = lambda: False")
    assert ours == theirs and len(set(ours)) == len(ours) == 150
    assert never == 0
    software = "llvmpipe" in (vulkan.device_name() or "")
    assert full > 0 if software else full == 0
