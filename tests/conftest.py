"""One device for the whole test process: the CPU in f64, where results are compared to round-off.

Kernels of the graph are those that compile soon, but where a module asks for the others.

Other precisions, backends and thread counts run through the command line, in processes of their
own. Modules in this folder that are not named test_... hold what tests share, and no test.
"""

import os
import sys
from pathlib import Path

os.environ["TI_SKIP_VERSION_CHECK"] = "ON"
# The checkout's `bench`. Last, so that the package is the one that is installed.
sys.path.append(str(Path(__file__).parents[1]))

import pytest
from commands import Commands
from hypothesis import settings
from pool import Pool
from screens import virtual_screen
from selection import mostly_thorough

# No example fails for its time: a busy machine takes longer than the 200 ms of the default.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")


@pytest.fixture(scope="session")
def device():
    import inside

    from taichi_cloth import runtime

    inside.refuse_both_ways()
    with pytest.MonkeyPatch.context() as patch:
        inside.compile_soon(patch)
        yield runtime.start("cpu", "f64", threads=2)


@pytest.fixture
def to_run_fast(device, monkeypatch):
    """Kernels of the graph as long runs and Python programs have them, which compile longer."""
    import inside

    inside.compile_to_run_fast(monkeypatch)


@pytest.fixture(autouse=True)
def keeps_the_device(device):
    """No test starts another device in this process: those after it would compute on that one."""
    yield
    from taichi_cloth import runtime

    assert runtime.still_runs(device), "the test started a device: it needs a process of its own"


@pytest.fixture(scope="session")
def pool(device):
    """Simulations that compile once for all tests: pool(scene, method, ...) -> one at its start."""
    return Pool()


@pytest.fixture
def few_lanes():
    """Packs of 2 lanes, which compile in a third of the time: for what holds for any number."""
    import inside

    with inside.few_lanes():
        yield


@pytest.fixture
def all_compiled_soon(device):
    """All kernels that compile from here on do so in about half the time, those of packs, too."""
    from taichi_cloth import runtime

    with runtime.compiled_soon():
        yield


@pytest.fixture(params=["serial", "parallel"])
def execution(request):
    return request.param


@pytest.fixture(params=["lanes", "graph"])
def topology(request):
    return request.param


WAYS = [f"{topology} {path}" for topology in ("lanes", "graph") for path in ("serial", "parallel")]


def _way(request):
    topology, execution = request.param.split()
    return {"topology": topology, "execution": execution}


@pytest.fixture(params=WAYS)
def way(request):
    """How a scene with a regular grid can be run: what holds for one way holds for all four."""
    return _way(request)


@pytest.fixture(params=mostly_thorough(WAYS, default=["lanes parallel", "graph serial"]))
def some_way(request):
    """The same where each costs much: by default two, which between them have all four words."""
    return _way(request)


@pytest.fixture(scope="session")
def caches(tmp_path_factory):
    """Folders of compiled kernels and of measured speeds, for commands that tests run."""
    folder = tmp_path_factory.mktemp("caches")
    return {"TI_OFFLINE_CACHE_FILE_PATH": str(folder / "ti"), "XDG_CACHE_HOME": str(folder)}


@pytest.fixture(scope="session")
def cli(caches):
    """Runs commands on the CPU, without a display: cli(words...) -> (stdout, stderr)."""
    commands = Commands(**caches, DISPLAY="", WAYLAND_DISPLAY="")
    yield commands
    commands.close()


@pytest.fixture(scope="session")
def cli_on(caches, cli, display):
    """The same on any backend: cli_on[arch](words...)."""

    class Started(dict):
        def __missing__(self, arch):
            self[arch] = Commands(**caches)
            return self[arch]

    started = Started(cpu=cli)
    yield started
    for arch, commands in started.items():
        if arch != "cpu":
            commands.close()


@pytest.fixture(scope="session")
def display():
    """A virtual display for this test process, unless it has one."""
    from taichi_cloth import runtime

    if runtime.display_available():
        yield os.environ.get("DISPLAY")
        return
    with virtual_screen() as name:
        os.environ["DISPLAY"] = name
        yield name
        del os.environ["DISPLAY"]
