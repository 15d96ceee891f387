"""The process of one task (`tasks.run`): it reads the task, does it, and writes its answer."""

from __future__ import annotations

import importlib
import os
import pickle
import shutil
import sys
import threading
from pathlib import Path

from taichi_cloth.errors import one_line
from taichi_cloth.sweeps.tasks import ANSWER, TASK, Task


def main(folder: Path) -> None:
    """Do the task in `folder`, which who started this process removes, or else this process."""
    threading.Thread(target=_end_with_parent, args=(folder,), daemon=True).start()
    answer: tuple[str, object]
    try:
        task: Task = pickle.loads((folder / TASK).read_bytes())
        for name, content in task.files.items():
            (folder / name).write_bytes(content)
        sys.path.insert(0, str(folder))
        os.chdir(folder)
        module, _, name = task.function.partition(":")
        answer = "done", getattr(importlib.import_module(module), name)(**task.arguments)
    except Exception as error:
        answer = "failed", one_line(error)
    # Under its own name it is whole.
    (folder / f"{ANSWER}.part").write_bytes(pickle.dumps(answer))
    (folder / f"{ANSWER}.part").rename(folder / ANSWER)


def _end_with_parent(folder: Path) -> None:
    """End, whatever this process is doing, once standard input ends: its parent has, too."""
    sys.stdin.read()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    os._exit(0)  # the thread that reads standard input would be in the way of an orderly end
