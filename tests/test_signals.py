"""What signals leave of a run: `taichi_cloth/signals.py`, the loop, and the files."""

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from commands import PROGRAM, after_start
from PIL import Image
from selection import thorough

from taichi_cloth.files import trajectory
from taichi_cloth.simulation.checkpoint import Checkpoint

NUMBERS = [signal.SIGHUP, signal.SIGINT, signal.SIGTERM]
WRITTEN = ["a.checkpoint.npz", "a.gif", "a.jsonl", "a.npz", "a.png", "out"]
WORDS = ["run", "cloth", "--columns", "8", "--rows", "6", "--headless", "--frames", str(10**9)]
WORDS += ["--save", "a.npz", "--export", "out", "--checkpoint", "a.checkpoint.npz"]
WORDS += ["--video", "a.gif", "--image", "a.png", "--record", "a.jsonl"]
WAITING = ("SigPnd", "ShdPnd", "SigBlk")
SAID = "taichi-cloth: interrupted\n"

pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")


def heard():
    """Have signals do what they do, also where what runs the tests has them ignored."""
    for number in NUMBERS:
        signal.signal(number, signal.SIG_DFL)


def begin(folder):
    """A run that writes all there is, from where it takes signals."""
    process = subprocess.Popen(
        [*PROGRAM, *WORDS],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heard,
    )
    if sets_of(process):
        while process.poll() is None and not is_in(NUMBERS, sets_of(process)["SigCgt"]):
            time.sleep(0.002)
    else:
        time.sleep(0.7)
    return process


def sets_of(process):
    """A process's sets of signals, by the system's names; none where it does not tell (Linux)."""
    try:
        lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    except OSError:
        return {}
    words = [line.split() for line in lines if line.startswith(("Sig", "Shd"))]
    return {name.rstrip(":"): int(bits, 16) for name, bits in words if name != "SigQ:"}


def is_in(numbers, bits):
    """Whether a set has all signals of these numbers."""
    return all(bits >> number - 1 & 1 for number in numbers)


def run(folder, moment, numbers, gap=0.0):
    """Begin a run and send it signals; (status, standard error, which ones may be the first).

    moment: seconds until the first one; None: when it has made its first frames.
    """
    process = begin(folder)
    try:
        if moment is None:
            process.stdout.readline()
        time.sleep(moment or 0.0)
        process.send_signal(numbers[0])
        first = numbers[:1]
        if numbers[1:]:
            time.sleep(gap)
            # POSIX does not order different signals that wait for a process at the same time. One
            # waits until the process runs again, or is blocked while its handler runs.
            sets = sets_of(process) if gap >= 0.001 else {"no gap": -1}
            if any(is_in(first, sets.get(name, 0)) for name in ("no gap", *WAITING)):
                first = numbers
            process.send_signal(numbers[1])
        _, error = process.communicate(timeout=120)
    finally:
        process.kill()
    return process.returncode, after_start(error), [128 + number for number in first]


@pytest.fixture(scope="module")
def to_frames(tmp_path_factory):
    """Seconds from where a run takes signals until it has made its first frames."""
    for _ in range(2):  # the first one may have to compile
        process = begin(tmp_path_factory.mktemp("measured"))
        began = time.perf_counter()
        process.stdout.readline()
        took = time.perf_counter() - began
        process.kill()
        process.communicate()
    return took


def last_frames(folder):
    """The last frame of each file of a run, by name; whole files are read without an error."""
    found = {}
    for path in folder.iterdir():
        if path.name == "a.npz":
            found[path.name] = max(trajectory.load(path).frame, default=0)
        elif path.name == "a.checkpoint.npz":
            found[path.name] = Checkpoint.load(path).frame
        elif path.name == "out":
            found[path.name] = max(int(file.stem[-5:]) for file in path.iterdir())
        elif path.name == "a.gif":
            with Image.open(path) as film:  # 50 of 60 frames
                found[path.name] = film.n_frames
        elif path.suffix == ".png":
            with Image.open(path) as picture:
                picture.load()
        else:
            assert path.name == "a.jsonl", path
    return found


def assert_ended_at_one_frame(folder):
    """All files of a run are there, and end at one frame, at least the first; or there is none."""
    names = sorted(path.name for path in folder.iterdir())
    assert names in ([], WRITTEN)
    if names:
        last = last_frames(folder)
        (frame,) = {last[name] for name in ("a.npz", "a.checkpoint.npz", "out")}
        assert frame >= 1
        assert last["a.gif"] == -(-frame * 5 // 6)


def test_all_files_end_at_one_frame_and_a_resumed_run_goes_on_with_the_next(tmp_path):
    status, error, _ = run(tmp_path, None, [signal.SIGTERM])
    assert (status, error) == (143, SAID)
    assert sorted(path.name for path in tmp_path.iterdir()) == WRITTEN
    assert_ended_at_one_frame(tmp_path)
    last = Checkpoint.load(tmp_path / "a.checkpoint.npz").frame
    more = ["run", "cloth", "--columns", "8", "--rows", "6", "--headless", "--frames", "2"]
    words = [*more, "--resume", "a.checkpoint.npz", "--save", "b.npz"]
    subprocess.run([*PROGRAM, *words], cwd=tmp_path, check=True, capture_output=True)
    both = [trajectory.load(tmp_path / name).frame for name in ("a.npz", "b.npz")]
    assert np.concatenate(both).tolist() == list(range(1, last + 3))


@thorough
@pytest.mark.parametrize("seed", range(100))
def test_one_signal_at_any_time(tmp_path, to_frames, seed):
    chance = random.Random(seed)
    number = chance.choice(NUMBERS)
    status, error, _ = run(tmp_path, chance.uniform(0, 1.5) * to_frames, [number])
    assert (status, error) == (128 + number, SAID)
    assert_ended_at_one_frame(tmp_path)


@thorough
@pytest.mark.parametrize("seed", range(50))
def test_two_signals_at_any_time(tmp_path, to_frames, seed):
    """What is there is whole, and nothing half-written is left."""
    chance = random.Random(seed)
    numbers, gap = chance.choices(NUMBERS, k=2), chance.choice([0, 0.001, 0.004, 0.02, 0.2, 1.0])
    status, error, first = run(tmp_path, chance.uniform(0, 1.5) * to_frames, numbers, gap)
    assert status in first and error == SAID
    last_frames(tmp_path)


def ended(program):
    """The status and standard error of a program in which signals are taken."""
    before = """
        import os, signal, sys, time
        from taichi_cloth import signals
        from taichi_cloth.files.pending import PendingFile, discard_all
        def send(*numbers):
            for number in numbers:
                os.kill(os.getpid(), number)
    """
    text = textwrap.dedent(before) + textwrap.dedent(program)
    words = [sys.executable, "-c", text]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=heard)
    return done.returncode, done.stderr


def test_the_first_signal_is_obeyed_where_the_program_looks():
    """Libraries go on meanwhile, also in what they wait for."""
    assert ended("""
        with signals.taken("told", discard_all, gives_back=True):
            send(signal.SIGTERM)
            import json
            try:
                signals.check()
            except signals.Ended as ended:
                sys.exit(ended.args[0])
    """) == (15, "")


def test_what_takes_long_ends_anywhere():
    assert ended("""
        with signals.taken("told", discard_all, gives_back=True):
            try:
                with signals.raising():
                    send(signal.SIGHUP)
                    time.sleep(60)
            except KeyboardInterrupt as ended:
                sys.exit(ended.args[0])
    """) == (1, "")


@pytest.mark.parametrize("numbers", ["15, 2", "2, 15", "1, 1"])
def test_a_second_signal_ends_at_once_with_the_status_of_the_first(numbers, tmp_path):
    """Also where both wait for Python, which would handle the lesser number first."""
    path = tmp_path / "half"
    first = 128 + int(numbers.split(",")[0])
    assert ended(f"""
        half = PendingFile({str(path)!r})
        with signals.taken("told", discard_all, gives_back=True):
            send({numbers})
            time.sleep(60)
    """) == (first, "told\n")
    assert not list(tmp_path.iterdir())


def test_a_second_signal_is_told_while_a_library_is_to_be_silent():
    """Descriptor 2 leads nowhere then."""
    assert ended("""
        with signals.taken("told", discard_all, gives_back=True):
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            send(signal.SIGTERM, signal.SIGINT)
            time.sleep(60)
    """) == (143, "told\n")


def test_a_process_that_ends_keeps_its_status():
    """As Python ends it would put back the system's handlers."""
    assert ended("""
        import atexit
        atexit.register(send, signal.SIGTERM, signal.SIGINT)
        with signals.taken("told", discard_all, gives_back=False):
            pass
        sys.exit(7)
    """) == (7, "")


def test_handlers_are_given_back():
    assert ended("""
        own = [signal.getsignal(n) for n in signals.NUMBERS]
        with signals.taken("told", discard_all, gives_back=True):
            assert signal.getsignal(signal.SIGINT) not in own
        assert [signal.getsignal(n) for n in signals.NUMBERS] == own
        signals.check()
    """) == (0, "")
