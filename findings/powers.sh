#!/usr/bin/env bash
# Taichi 1.7.4 and Quadrants 1.3.3 on the CPU, whole and real numbers:
# - A whole number to the power of a negative one is that to the power without its sign: 2 ** -3
#   is 8, 3 ** -5 is 243, silently, where the exponent is a variable. With a constant exponent the
#   compiler refuses. Documented (`ti.pow`): "an exception ... if debug mode or optimization
#   passes are on; otherwise 1" (optimization passes are on here).
# - `x % y` of floats is x - (x // y) * y, each step rounded: in f32 1e9 % 7 is 64, nine times the
#   divisor (Python, and NumPy in f32: 6), and 5 % inf is nan (both: 5). Documented (`ti.mod`):
#   "equivalent to the Python modulus operator".
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q taichi==1.7.4 quadrants==1.3.3 numpy==2.2.6
for library in taichi quadrants; do
cat > "$folder/run.py" <<PYTHON
import math

import numpy as np
import $library as ti

ti.init(arch=ti.cpu, log_level=ti.CRITICAL, offline_cache=False)


@ti.kernel
def power(a: ti.i32, b: ti.i32) -> ti.i32:
    return a**b


@ti.kernel
def constant(a: ti.i32) -> ti.i32:
    return a ** (-3)


@ti.kernel
def rest(a: ti.f32, b: ti.f32) -> ti.f32:
    return a % b


powers = {(a, b): power(a, b) for a, b in ((2, -1), (2, -3), (3, -5), (0, -1), (2, 3))}
print("$library", ti.__version__, powers)
assert powers == {(2, -1): 2, (2, -3): 8, (3, -5): 243, (0, -1): 0, (2, 3): 8}
try:
    constant(2)
except RuntimeError as error:
    print("constant exponent:", str(error).strip().splitlines()[-1][-60:])
else:
    raise AssertionError("a constant negative exponent was accepted")

rests = [rest(1e9, 7), rest(5, math.inf)]
exact = [float(np.float32(x) % np.float32(y)) for x, y in ((1e9, 7), (5, math.inf))]
print("1e9 % 7, 5 % inf in f32:", rests, "NumPy:", exact)
assert exact == [6, 5] and rests[0] == 64 and math.isnan(rests[1])
PYTHON
TI_SKIP_VERSION_CHECK=ON "$folder/venv/bin/python" "$folder/run.py"
done
