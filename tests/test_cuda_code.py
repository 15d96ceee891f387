"""What is compiled for CUDA, without a card: it waits at one place, and reads what was written."""

import sys

import cuda_code
import pytest
from lacking import needs_compiler
from selection import mostly_thorough

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the driver is one for Linux")

PAIRS = [
    ("pull", "verlet", "f64"),  # a launch of what obstacles do, between those of others
    ("cloth", "verlet", "f32"),
    ("chain", "implicit_euler", "f64"),  # one block
    ("warp", "tr_bdf2", "f64"),  # links of grids, air
    ("trampoline", "vbd", "f64"),  # in parts, as real functions
    ("flag", "xpbd", "compensated"),
    ("drape", "implicit_midpoint", "f32"),
    ("box", "rk4", "f64"),
]

WAIT = """.func two_ways(
	.param .b32 two_ways_param_0
)
{{
	mov.u32 	%r1, {which};
	setp.eq.s32 	%p1, %r1, 0;
	@%p1 bra 	$L1;
	bra.uni 	$L2;
$L1:
	{first}
	st.u32 	[%rd1], 1;
	bra.uni 	$L3;
$L2:
	{second}
$L3:
	{last}
	ret;
}}
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    folder = tmp_path_factory.mktemp("driver")
    cuda_code.make_driver(folder)
    return folder


@needs_compiler
@pytest.mark.parametrize(
    ("scene", "method", "precision"), mostly_thorough(PAIRS, default=PAIRS[:1])
)
def test_threads_wait_at_one_place_and_no_read_misses_a_store(
    driver, tmp_path, scene, method, precision
):
    """Of each kernel of a frame. In f32 springs' roots have no branch, over which no read moves."""
    code = cuda_code.code_of(driver, tmp_path, scene, method, precision)
    assert sum(map(cuda_code.barriers, code)) > 0
    assert [where for text in code for where in cuda_code.parted(text)] == []
    assert not any("ld.global.nc" in text for text in code)
    if (scene, precision) == ("cloth", "f32"):
        assert any("rsqrt" in text for text in code)
        assert not any("sqrt.rn" in text for text in code)


@needs_compiler
def test_all_that_draws_compiles(driver, tmp_path):
    code = cuda_code.code_of(driver, tmp_path, cuda_code.DRAWING, "-", "f32")
    kernels = {name.split("_c")[0] for text in code for name, _ in cuda_code.functions(text)}
    assert {"lay", "see", "draw", "gather", "paint", "put", "as_bytes"} <= kernels
    assert not any("ld.global.nc" in text for text in code)


def test_ways_that_part_at_a_barrier_are_found():
    """Where they part by the thread, and only those."""
    way = {"which": "%tid.x", "first": "bar.sync 	0;", "second": "bar.sync 	0;", "last": ""}
    assert cuda_code.parted(WAIT.format(**way)) == [("two_ways", "")]
    assert cuda_code.barriers(WAIT.format(**way)) == 2
    assert cuda_code.parted(WAIT.format(**way | {"which": "%nctaid.x"})) == []
    meets = way | {"first": "", "second": "", "last": "bar.sync 	0;"}
    assert cuda_code.parted(WAIT.format(**meets)) == []
