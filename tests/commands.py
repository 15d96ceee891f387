"""`taichi-cloth` as tests call it: in a process of its own, or in one that does many commands.

To start an interpreter and Taichi takes a second; `Commands` pays it once. What is about processes
(signals, pipes, exit statuses) uses `command`.
"""

import contextlib
import importlib
import io
import json
import os
import re
import select
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

PROGRAM = [sys.executable, "-m", "taichi_cloth"]
PATIENCE = 300  # seconds that a command may take
LAST_WORDS = 4000  # bytes of standard error that are shown of a process that ended
COMPILING = re.compile(r"taichi-cloth: compiling kernels for this run: [^\n]*\n")


def after_start(err):
    """What a run printed on standard error but for the word that kernels are being compiled, which
    depends on what ran before.
    """
    return COMPILING.sub("", err)


def command(*arguments, check=0, env=None, cwd=None):
    """Run `taichi-cloth` in a process of its own; return (stdout, stderr `after_start`)."""
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        cwd=cwd,
        env={**os.environ, **(env or {})},
    )
    assert done.returncode == check, f"exit {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout, after_start(done.stderr)


class Commands:
    """A process that does commands one after the other, as `command` would.

    environment: variables that it gets besides this process's own. One process for each backend:
    drivers of OpenGL and Vulkan do not like to be left and taken up again.
    """

    def __init__(self, **environment):
        folders = [str(Path(__file__).parent), *(path for path in sys.path if path)]
        environment["PYTHONPATH"] = os.pathsep.join(folders)
        # Where it crashes, it says in which line.
        self._environment = {**os.environ, "PYTHONFAULTHANDLER": "1", **environment}
        self._start()

    def _start(self):
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  (open while the process is)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "commands"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=self._environment,
        )

    def __call__(self, *arguments, check=0, env=None, cwd=None):
        """Do a command; return (stdout, stderr `after_start`). env: for this one only."""
        words = [str(word) for word in arguments]
        status, out, err = self._ask(do=words, env=env or {}, cwd=str(cwd) if cwd else None)
        assert status == check, f"exit {status}: {out}{err}"
        return out, after_start(err)

    def call(self, function, **arguments):
        """Call a function, "module:name", of a module in this folder, there; what it returns."""
        status, result, err = self._ask(call=function, arguments=arguments)
        assert status == 0, err
        return result

    def _ask(self, **request):
        print(json.dumps(request), file=self._process.stdin, flush=True)
        ready, _, _ = select.select([self._process.stdout], [], [], PATIENCE)
        line = self._process.stdout.readline() if ready else ""
        if not line:
            how = f"it ended with {self._process.wait()}" if ready else f"not in {PATIENCE} s"
            self.close()
            self._errors.seek(0)
            last = self._errors.read()[-LAST_WORDS:].decode(errors="replace")
            self._start()  # for those that come after
            raise AssertionError(f"no answer to {request}: {how}; its last words: {last}")
        return json.loads(line)

    def close(self):
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()


def _serve():
    """Do what standard input asks for, one request a line."""
    # Libraries greet on standard output: the answers keep it for themselves.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        answer = _called(**request) if "call" in request else _done(**request)
        print(json.dumps(answer), file=answers, flush=True)


def _done(do, env, cwd):
    """A command: its exit status and what it printed."""
    from taichi_cloth.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    home, environment = os.getcwd(), dict(os.environ)
    os.environ.update(env)
    os.chdir(cwd or home)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(do)
    except Exception:
        status = 1
        err.write(traceback.format_exc())
    finally:
        os.chdir(home)
        os.environ.clear()
        os.environ.update(environment)
    return status, out.getvalue(), err.getvalue()


def printed_by(program):
    """What a Python program prints; in packs of 2 lanes, which compile sooner."""
    from inside import few_lanes

    out = io.StringIO()
    with few_lanes(), contextlib.redirect_stdout(out):
        exec(program, {"__name__": "example"})
    return out.getvalue()


def end_taichi():
    """Let Taichi write what it compiled to its cache, as it does when a process ends."""
    import taichi

    taichi.reset()


def _called(call, arguments):
    """A function: 0 and what it returned, or 1 and what went wrong."""
    module, _, name = call.partition(":")
    try:
        return 0, getattr(importlib.import_module(module), name)(**arguments), ""
    except Exception:
        return 1, None, traceback.format_exc()


if __name__ == "__main__":
    _serve()
