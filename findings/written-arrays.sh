#!/usr/bin/env bash
# Taichi 1.7.4 on Vulkan (a driver is needed; Mesa's lavapipe serves): a NumPy array that a kernel
# writes, and does not read, is not copied to the device before it runs, but is copied back whole.
# So what the kernel leaves out comes back as what an earlier array left there, silently: a kernel
# that sets the first half of an array of zeros brings back ones in the other half, too, after one
# that had set all of another array. On the CPU, and where the kernel reads the array as well, the
# other half stays 0. Documented ("Interacting with External Arrays"): such an argument is passed by
# reference, without a copy.
#
# And a loop over range(x.shape[0] // 2) at the top of a kernel is refused there ("Not supported"),
# which inside another loop, or as >> 1, is not.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q taichi==1.7.4 numpy==2.2.6
cat > "$folder/run.py" <<'PYTHON'
import sys

import numpy as np
import taichi as ti

ti.init(arch=getattr(ti, sys.argv[1]), log_level=ti.CRITICAL, offline_cache=False)
assert ti.cfg.arch == getattr(ti, sys.argv[1]), "no Vulkan here"
array = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.kernel
def fill(x: array):
    for i in range(x.shape[0]):
        x[i] = 1


@ti.kernel
def fill_half(x: array):
    for i in range(x.shape[0] >> 1):
        x[i] = 1


@ti.kernel
def add_half(x: array):
    for i in range(x.shape[0] >> 1):
        x[i] += 1


@ti.kernel
def fill_part(x: array):
    for i in range(x.shape[0] // 2):
        x[i] = 1


@ti.kernel
def fill_inside(x: array):
    for _ in range(1):
        for i in range(x.shape[0] // 2):
            x[i] = 1


fill_inside(np.zeros(8, np.int32))
found = []
for kernel in (fill_half, add_half):
    fill(np.zeros(8, np.int32))
    x = np.zeros(8, np.int32)
    kernel(x)
    found.append(x.tolist())
print(sys.argv[1], ti.__version__, "written:", found[0], "read and written:", found[1])
half = [1, 1, 1, 1, 0, 0, 0, 0]
on_vulkan = sys.argv[1] == "vulkan"
assert found == [[1] * 8 if on_vulkan else half, half]
try:
    fill_part(np.zeros(8, np.int32))
except RuntimeError as error:
    print("range(x.shape[0] // 2):", str(error).strip()[-14:])
    assert on_vulkan
else:
    assert not on_vulkan
PYTHON
for arch in cpu vulkan; do
TI_SKIP_VERSION_CHECK=ON "$folder/venv/bin/python" "$folder/run.py" "$arch"
done
