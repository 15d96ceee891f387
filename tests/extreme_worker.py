"""Runs extreme cases in one precision, and says what came of them.

    python tests/extreme_worker.py f32|f64 [METHOD | METHOD/CASE | /CASE | ^METHOD/CASE ...]

Prints one result a line, as JSON, in the order of the methods.
"""

import argparse
import json
import math
import sys
import time

import numpy as np
from extreme_cases import CASES, KINDS
from extreme_runs import Run

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.sweeps.tasks import Finished

PRECISIONS = "f32", "f64"
FILES = "extreme_cases.py", "extreme_contacts.py", "extreme_runs.py", "extreme_worker.py"

# --- running ---------------------------------------------------------------------------------


class Runner:
    """Runs cases of one method, each kind in one simulation."""

    def __init__(self, method):
        self.method, self.module = method, methods.load(method)
        self._sims = {}

    def steps(self, case):
        """None where the case does not apply."""
        return case.steps(self.module, case.scene())

    def _started(self, case, made, steps):
        if case.kind not in self._sims:
            self._sims[case.kind] = Simulation(
                KINDS[case.kind](), self.method, topology="graph", execution="serial", soon=True
            )
        sim = self._sims[case.kind]
        sim.load_scene(made, steps.frame, steps.substeps)
        return sim

    def run(self, case):
        """The result as a dict: status "held", "failed" (by name) or "broken", and each ask."""
        began = time.perf_counter()
        made, steps = case.scene(), self.steps(case)
        precision = runtime.current_device().precision
        result = {"method": self.method, "case": case.name, "precision": precision}
        result["steps"], result["dt"] = steps.count, steps.dt
        try:
            sim = self._started(case, made, steps)
        except InputError as refusal:
            expected = precision in case.refused
            result["status"], result["failure"] = "failed" if expected else "broken", str(refusal)
            faults = [] if expected else ["this precision should hold the scene"]
            seconds = round(time.perf_counter() - began, 3)
            return result | {"asks": [], "unconverged": 0, "faults": faults, "seconds": seconds}
        run = Run(self.module, sim, made, steps)
        asked = [{"words": ask.words, "value": 0.0, "bound": 1.0, "part": 0.0} for ask in case.asks]
        failure = None
        chunk = 1 if case.drive else max(1, -(-steps.frames // case.checks))
        try:
            while sim.frame < steps.frames:
                if case.drive:
                    case.drive(sim, sim.frame)
                sim.advance(min(chunk, steps.frames - sim.frame))
                run.look()
                for ask, said in zip(case.asks, asked, strict=True):
                    value, bound = (float(n) for n in ask.measure(run))
                    part = _part(value, bound)
                    if not part <= said["part"] or said["value"] == 0:
                        said.update(value=value, bound=bound, part=part)
        except SimulationFailure as error:
            failure = error
        result["asks"], result["unconverged"] = asked, sim.work().unconverged
        result["status"] = self._judge(case, asked)
        if failure:
            result["failure"] = str(failure)
            result["faults"] = self._faults(case, made, steps, sim, failure)
            bad = case.fails == "never" or result["faults"] or result["status"] == "broken"
            result["status"] = "broken" if bad else "failed"
        elif case.fails == "must" or precision in case.refused:
            result["status"] = "broken"
        result["seconds"] = round(time.perf_counter() - began, 3)
        return result

    def _judge(self, case, asked):
        """Whether the bounds "held", or are "broken", or it is known that the method is "wrong"."""
        status = "held"
        factor, of_case = case.errors.get(self.method) or case.errors.get("*", (1.0, ""))
        for ask, said in zip(case.asks, asked, strict=True):
            if said["part"] <= 1:
                continue
            most, of_ask = ask.errors.get(self.method, (-math.inf, ""))
            known = said["part"] <= factor or said["value"] <= most
            said["why"] = of_ask if said["value"] <= most else of_case
            if not known:
                return "broken"
            status = "wrong"
        return status

    def _faults(self, case, made, steps, sim, failure):
        """What is wrong with how a run failed."""
        faults = []
        x, v = sim.positions(), sim.velocities()
        limit = sim.speed_limit
        if failure.frame != sim.frame + 1:
            faults.append(f"frame {failure.frame}, but {sim.frame} are good")
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            faults.append("the state kept is not finite")
        within = (np.linalg.norm(v, axis=1) <= limit * (1 + 1e-6)).all()
        if failure.frame > 1 and not within:
            faults.append("the state kept is above the speed limit")
        if not case.drive:
            sim = self._started(case, made, steps)
            sim.advance(failure.frame - 1)
            same = np.array_equal(x, sim.positions()) and np.array_equal(v, sim.velocities())
            if not same:
                faults.append("the state kept is not that of the last good frame")
        if not (failure.cause and failure.remedy and str(failure.particle) in str(failure)):
            faults.append("it is not named")
        return faults


def _part(value, bound):
    """How much of the bound a value takes; NaN as infinity."""
    if not math.isfinite(value) or math.isnan(bound):
        return math.inf
    if bound > 0:
        return value / bound
    return 0.0 if value <= bound else math.inf


def applicable(method):
    """Names of the cases that apply to a method."""
    module = methods.load(method)
    return [name for name, case in CASES.items() if case.steps(module, case.scene()) is not None]


def finished(precision, method, keys):
    """What came of cases of a method, as a task (`sweeps.tasks`) has it; keys: by case."""
    _start(precision)
    runner = Runner(method)
    return [Finished(key, runner.run(CASES[name])) for name, key in keys.items()]


def _start(precision):
    np.seterr(over="ignore")  # of energies of what overflows
    runtime.start("cpu", precision, threads=1)


def main(arguments):
    parser = argparse.ArgumentParser()
    parser.add_argument("precision", choices=PRECISIONS)
    parser.add_argument(
        "what", nargs="*", help="METHOD, METHOD/CASE or /CASE; all where absent; ^: not this one"
    )
    options = parser.parse_args(arguments)
    but = {word[1:] for word in options.what if word.startswith("^")}
    what = {word for word in options.what if not word.startswith("^")}
    _start(options.precision)
    for method in methods.METHODS:
        runner = None
        for name in CASES:
            if f"{method}/{name}" in but:
                continue
            if what and not {method, f"{method}/{name}", f"/{name}"} & what:
                continue
            runner = runner or Runner(method)
            if runner.steps(CASES[name]) is not None:
                print(json.dumps(runner.run(CASES[name])), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
