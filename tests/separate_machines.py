"""Sweeps over machines that share nothing but a network, whose cables are pulled while they run.

    python tests/separate_machines.py        as root, on Linux, with iproute2

A machine here is a network namespace with a host name, a temporary folder and a home of its own; a
pulled cable is its link taken down, so that nothing says goodbye, as when a process is killed. One
has the scheduler, two have a worker each, and from the fourth `trade` is asked: alone, with `--on`,
while a worker goes, and while the machine goes that is timed, after which `--resume` goes on.
A line each: the exit status, seconds, and whether all columns but times are those of the first.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from test_journal import rows_of

HUB, FRONT, DESK, NODES = "hub", "front", "desk", ("node7", "node8")
MACHINES = FRONT, DESK, *NODES
ADDRESS = "tcp://10.90.0.2:8786"  # of the scheduler, on the second machine
ROOT = Path(__file__).parents[1]
SCENE = "cloth", "--columns", "30", "--rows", "20"
SETTINGS = "--methods", "verlet,rk4,xpbd", "--substeps", "2,4,8"
ASKED = "trade", *SCENE, *SETTINGS, "--frames", "60"
# A machine's name, then a command: both in what is its own.
OWN = 'hostname "$0"; mount -t tmpfs none /mnt; export HOME=/mnt TMPDIR=/mnt; exec "$@"'


def ip(*words):
    subprocess.run(["ip", *words], check=True)


@contextlib.contextmanager
def network():
    """Namespaces of machines, each with a cable to a hub."""
    try:
        ip("netns", "add", HUB)
        ip("-n", HUB, "link", "add", "middle", "type", "bridge")
        ip("-n", HUB, "link", "set", "middle", "up")
        for number, name in enumerate(MACHINES, 1):
            ip("netns", "add", name)
            cable = "link", "add", name, "type", "veth", "peer", "name", "out", "netns", name
            ip("-n", HUB, *cable)
            ip("-n", HUB, "link", "set", name, "master", "middle", "up")
            ip("-n", name, "address", "add", f"10.90.0.{number}/24", "dev", "out")
            ip("-n", name, "link", "set", "out", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield
    finally:
        for name in (*MACHINES, HUB):
            subprocess.run(["ip", "netns", "delete", name], check=False)


def plug(name, state):
    ip("-n", HUB, "link", "set", name, state)


def on(name, *module, **files):
    """A Python module on a machine, which finds the package where it is here."""
    own = "ip", "netns", "exec", name, "unshare", "--mount", "--uts", "bash", "-c", OWN, name
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([*own, sys.executable, "-m", *module], env=environment, **files)


@contextlib.contextmanager
def ending(process):
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def started(name, *words, says, log):
    """A program of Dask's on a machine, once it has said that it is there."""
    with log.open("w") as file:
        process = on(name, "distributed.cli." + words[0], *words[1:], stdout=file, stderr=file)
    while says not in log.read_text():
        if process.poll() is not None:
            raise SystemExit(f"{name}: {log.read_text()}")
        time.sleep(0.1)
    return ending(process)


def worker(name, logs):
    words = "dask_worker", ADDRESS, "--nthreads", "1"
    return started(name, *words, says="Registered to", log=logs / f"{name}.log")


def trade(folder, *words, pull="", once=""):
    """The exit status, what it said last and seconds of a sweep; the cable of machine `pull` goes
    when a line of the journal has `once`.
    """
    begun, log = time.monotonic(), folder.with_suffix(".log")
    with log.open("w") as file:
        words = "taichi_cloth", *ASKED, "--output", str(folder), *words
        process = on(FRONT, *words, stdout=file, stderr=file)
        journal = folder / "sweep.jsonl"
        while pull and process.poll() is None:
            if journal.exists() and once in journal.read_text():
                plug(pull, "down")
                break
            time.sleep(0.1)
        process.wait()
    return process.returncode, log.read_text().splitlines()[-1], time.monotonic() - begun


def table(folder):
    """The rows of a trade, without what a clock says, or whose."""
    return [row | {"timed_on": ""} for row in rows_of(folder)]


def main():
    with tempfile.TemporaryDirectory() as name, network():
        folder = Path(name)

        def show(what, to, *words, **cut):
            status, last, seconds = trade(folder / to, *words, **cut)
            same = table(folder / to) == table(folder / "alone")
            print(f"{what}: status {status}, {seconds:.0f} s, same rows: {same}", flush=True)
            if status:
                print(f"  {last}", flush=True)

        show("alone", "alone")
        scheduler = "dask_scheduler", "--host", "10.90.0.2", "--no-dashboard"
        says = "Scheduler at"
        there = "--on", ADDRESS, "--times-on", NODES[0]
        with started(DESK, *scheduler, says=says, log=folder / "desk.log"):
            with worker(NODES[0], folder):
                with worker(NODES[1], folder):
                    show("--on", "on", *there)
                    sampled = r"\"verlet\""  # in a key: of what workers do
                    show(f"{NODES[1]} cut off", "cut", *there, pull=NODES[1], once=sampled)
                    plug(NODES[1], "up")
                timed = '"seconds": ['
                show(f"{NODES[0]}, timed, cut off", "again", *there, pull=NODES[0], once=timed)
                plug(NODES[0], "up")
            with worker(NODES[0], folder):
                show("--resume", "again", *there, "--resume")


if __name__ == "__main__":
    main()
