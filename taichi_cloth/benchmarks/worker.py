"""A process in which contestants run: one JSON request a line in, one JSON answer a line out.

    {"make": "module:Class", "as": KEY, "with": {...}}  ->  {"result": the contestant's `about`}
    {"of": KEY, "do": METHOD, "with": {...}}            ->  {"result": ..., "seconds": ...}
    {"drop": KEY}                                       ->  {"result": null}

An array is answered with the name of the file it was saved to, in the folder that is this
process's argument. What goes wrong is answered as {"failed": "one line"}.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import sys
import time
from pathlib import Path

import numpy as np


def main(folder: Path) -> None:
    """Serve requests until standard input ends."""
    # Libraries greet on standard output: the answers keep it for themselves.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    contestants = {}
    for number, line in enumerate(sys.stdin):
        try:
            answer = _answer(json.loads(line), contestants, folder / f"{os.getpid()}-{number}.npy")
        except Exception as error:
            answer = {"failed": " ".join(f"{type(error).__name__}: {error}".split())[:300]}
        print(json.dumps(answer), file=answers, flush=True)


def _answer(request: dict, contestants: dict, file: Path) -> dict:
    if "make" in request:
        module, _, name = request["make"].partition(":")
        made = getattr(importlib.import_module(module), name)(**request["with"])
        contestants[request["as"]] = made
        return {"result": getattr(made, "about", {})}
    if "drop" in request:
        del contestants[request["drop"]]
        gc.collect()
        return {"result": None}
    method = getattr(contestants[request["of"]], request["do"])
    begin = time.perf_counter()
    result = method(**request["with"])
    seconds = time.perf_counter() - begin
    if isinstance(result, np.ndarray):
        np.save(file, result)
        result = str(file)
    return {"result": result, "seconds": seconds}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
