"""Budgets of ``taichi-cloth run``: `--hold`, and the row of the panel that chooses one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from taichi_cloth.budgets import goal as goals
from taichi_cloth.cli import run_beside
from taichi_cloth.cli.run_meter import MeasuredErrors
from taichi_cloth.errors import BudgetMissed, InputError, counted
from taichi_cloth.render import style
from taichi_cloth.runtime import current_device
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.ui.chrome.budget import METHOD, OFF, SETS
from taichi_cloth.ui.text import Word

if TYPE_CHECKING:
    from taichi_cloth.budgets.keeper import Keeper, StableSteps
    from taichi_cloth.simulation.live import Value
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.interaction import Log
    from taichi_cloth.ui.view import View

UNSEEN = (
    "--hold {}: a headless run has no frames to be in time for; hold an error, such as 1%, or open "
    "a window"
)
# Where errors are measured for a frame's time alone, so many seconds say what is to be chosen. Then
# it rests for so many times as long as each takes: of the frames of a cloth that was drawn in
# software on two cores, 5 to 8 % were late while errors were measured, else 1 to 3 %.
MEASURED, RESTS = 5, 4.0
# Seconds of a run in which an error may be above what is held, as these show what it takes; the
# part of the others that may be; and the part of the frames that are to be in time.
SEARCH, ALLOWED, TIMELY = 3, 0.02, 0.95
USUAL = ("60fps", "30fps", "1%", "0.1%")  # what the panel offers


class HeldBudget:
    """The budget of a run, none at first: for the command line, and for a window's panel.

    errors: of the same run, which are switched on: an error is held by them, and of the substeps
    for which there is time they say how many are of use, and which method is most accurate, once
    there is time for more than the fewest: to measure takes processor time, too. windowed: whether
    frames are drawn, in whose time there is a sense. told: whether changes are printed. kept: why
    the method stays as it is; "": it is chosen, until the user sets one.
    """

    about = "keeps to frames a second, or to an error of each second: by method, substeps, solver"

    def __init__(
        self,
        sim: Simulation,
        errors: MeasuredErrors,
        *,
        windowed: bool,
        told: bool,
        kept: str = "",
    ) -> None:
        self._sim, self._errors, self._kept = sim, errors, kept
        self._windowed, self._told = windowed, told
        self._keeper: Keeper | None = None
        self._stable: StableSteps | None = None
        self._frames = self._in_time = 0
        self._substeps: list[int] = []
        self._changing, self._compiled = False, 0.0  # the method; seconds that such frames took
        self._changes = 0
        self._earlier = 0  # verdicts of before
        self._bounded = False  # whether what bounds the substeps is known, or being measured
        self._measures = False  # whether nobody else wanted errors to be measured
        self.chosen = OFF
        self.fixed = "--dt auto chooses the substeps" if sim.follows else ""

    @property
    def words(self) -> tuple[str, ...]:
        """The budgets that may be chosen; one asked for in other words is among them."""
        more = () if self.chosen in (OFF, *USUAL) else (self.chosen,)
        return (OFF, *USUAL, *more)

    @property
    def why(self) -> str:
        """Its last choice, and the reason."""
        choice = self._keeper.choice if self._keeper else None
        if choice is None:
            return ""
        solver = [f"{name} {value:g}" for name, value in choice.solver.items()]
        return ", ".join([self._sim.method, *solver, choice.why])

    @property
    def shortens(self) -> bool:
        """True if to hold frames a second would make frames shorter: with the fewest substeps that
        are stable, where there are more, and no such budget has chosen them.
        """
        if self.fixed or (self._keeper is not None and self._keeper.goal.seconds is not None):
            return False
        if self._sim.substeps == 1:
            return False
        if self._stable is None:
            from taichi_cloth.budgets.keeper import StableSteps

            self._stable = StableSteps(self._sim)
        return self._stable.least() < self._sim.substeps

    def status(self) -> Word | None:
        """Its words in the status."""
        if self._keeper is None:
            return None
        choice = self._keeper.choice
        said = f"hold {self.chosen}" + (f": {choice.short}" if choice else "")
        return Word(said, style.GOOD if choice is None or choice.met else style.WARN, 1)

    def choose(self, word: str) -> None:
        """Hold something else from now on."""
        if word == OFF:
            self._end()
            return
        from taichi_cloth.budgets.keeper import Keeper

        goal = goals.read(word, "hold")
        if self.fixed:
            raise InputError(f"hold: {self.fixed}")
        if goal.seconds is not None and not self._windowed:
            raise InputError(UNSEEN.format(word))
        if goal.error is not None:
            self._measure(word)
        self._keeper = Keeper(self._sim, goal, kept=self._kept)
        self.chosen = goal.words
        self._errors.try_methods(self._keeper.trials)
        if goal.error is not None:
            self._measures = False
            self._errors.rest(0.0)
        self._frames = self._in_time = self._changes = 0
        self._changing, self._compiled = False, 0.0
        self._substeps, self._earlier = [], len(self._errors.verdicts)
        unrounded = current_device().precision == "f64" and not self._keeper.chooses_method
        self._bounded = goal.error is not None or unrounded

    def _end(self) -> None:
        """Hold nothing any more."""
        self._keeper, self.chosen = None, OFF
        self._errors.try_methods(None)

    def _measure(self, word: str) -> None:
        """Have errors measured."""
        if not self._errors.on:
            self._errors.switch()
        if refused := self._errors.refused:
            raise InputError(f"--hold {word}: the error cannot be measured: {refused}")

    def by_hand(self, name: str) -> str:
        """The user set what it sets: hold nothing any more, or for a method, leave that as it is;
        what to tell of it, "": nothing.
        """
        held, word = self._keeper, self.chosen
        if name == METHOD:
            self._kept = "it was set by hand"
            if held is not None:
                held.kept = self._kept
            return f"hold {word} leaves the method as it was set" if held else ""
        self._end()
        return f"nothing is held any more, as {name} was set" if held else ""

    def unmeasured(self) -> bool:
        """The error meter was switched off: hold no error any more; whether one was held."""
        held = self._keeper is not None and self._keeper.goal.error is not None
        if held:
            self._end()
        return held

    def before_frame(self, give: Callable[[str, Value], None]) -> None:
        """Choose for the next frame."""
        if self._keeper is None:
            return
        choice = self._keeper.choose(self._errors.verdicts)
        if not self._bounded and self._keeper.has_room:
            self._bounded = True
            if not self._errors.on:
                self._errors.switch()  # which finds how many substeps rounding allows
                self._measures = True
        if self._measures and len(self._errors.verdicts) == MEASURED:
            self._errors.rest(RESTS)
        method = self._sim.method
        now: dict[str, Value] = {METHOD: method, "substeps": self._sim.substeps}
        now |= self._sim.solver
        chosen: dict[str, Value] = {METHOD: choice.method or method, "substeps": choice.substeps}
        chosen |= choice.solver
        for name, value in chosen.items():
            if value != now[name]:
                give(name, value)
        self._changing = self._sim.method != method
        if self._told and chosen != now:
            print(f"frame {self._sim.frame}: hold {self.chosen}: {self.why}", flush=True)

    def after_frame(self, simulate: float, rest: float) -> None:
        """Note what a frame took."""
        if self._keeper is None:
            return
        if self._windowed:  # else nothing follows from what this machine takes
            self._keeper.frame(simulate, rest)
        if self._changing:
            self._changes += 1
            self._compiled += simulate
            if self._told and self._windowed:
                print(f"frame {self._sim.frame}: to change the method took {simulate:.2g} s")
        self._frames += 1
        seconds = self._keeper.goal.seconds
        self._in_time += seconds is not None and simulate + rest <= seconds
        self._substeps.append(self._sim.substeps)

    def summary(self) -> str:
        """Its outcome since it was chosen, in a line; "": nothing was held at the end."""
        if self._keeper is None or not self._frames:
            return ""
        goal, least, most = self._keeper.goal, min(self._substeps), max(self._substeps)
        how = f"{least} to {most}" if most > least else f"{least}"
        how += " substeps"
        if self._changes:
            how += f" and {counted(self._changes, 'change')} of the method"
            if self._windowed:
                how += f", to compile {self._compiled:.2g} s"
        return f"hold {goal.words}: {self._held()[0]}, by {how}; now {self.why}"

    def missed(self) -> BudgetMissed | None:
        """The failure of a budget that was not held; None: it was, or nothing was to be."""
        if self._keeper is None or not self._frames:
            return None
        said, kept = self._held()
        if kept:
            return None
        return BudgetMissed(f"--hold {self.chosen} was not held: {said}; {self.why}")

    def _held(self) -> tuple[str, bool]:
        """In which frames and seconds the goal was held, in words, and whether that is enough.

        Enough is all but one second in fifty, or one frame in twenty for a frame's time. The first
        seconds are a search, and do not count where there are others.
        """
        assert self._keeper is not None
        goal, choice = self._keeper.goal, self._keeper.choice
        met = choice is None or choice.met
        if goal.seconds is not None:
            part = self._in_time / self._frames
            words = f"held in {100 * part:.3g} % of {self._frames} frames"
            return words, part >= TIMELY
        since = self._errors.verdicts[self._earlier :]
        known = [v for v in since if v.known and not (v.resting or v.trouble)]
        aim = goal.error or 0.0
        if not known:
            return "no frame was measured", any(v.resting for v in since)
        within = [verdict.relative <= aim for verdict in known]
        frames = sum(v.judged for v in known)
        good = 100 * sum(v.frames_within(aim) for v in known) / frames
        words = f"held in {good:.3g} % of {frames} frames that were measured, and over "
        words += f"{sum(within)} of {counted(len(known), 'window')} as a whole"
        counting = within[SEARCH:] or within[-1:]
        if len(within) > SEARCH and not all(within[:SEARCH]):
            words += f" ({sum(counting)} of {len(counting)} after the search of the first {SEARCH})"
        return words, met and counting.count(False) <= ALLOWED * len(counting)


@contextlib.contextmanager
def held(
    sim: Simulation, options: RunOptions, errors: MeasuredErrors, view: View
) -> Iterator[HeldBudget]:
    """The budget of a run, which is kept from the start if the options ask for one."""
    told = options.hold is not None and not options.quiet
    kept = "--method gave it" if "method" in options.given else ""
    if run_beside.asked(options):
        kept = "another run is compared with it"
    budget = HeldBudget(sim, errors, windowed=view.visible, told=told, kept=kept)
    if options.hold is not None:
        budget.choose(options.hold)
    yield budget
    said = budget.summary()
    if said and not options.quiet:
        print(said, flush=True)


def checked(options: RunOptions) -> RunOptions:
    """The options of a run; refuses a budget that cannot be kept."""
    if options.hold is None:
        if options.strict:
            raise InputError("--strict is of a budget: give --hold 1%, or another one, with it")
        return options
    if goals.read(options.hold).seconds is not None and options.view == "none":
        raise InputError(UNSEEN.format(options.hold))
    if options.dt == "auto" and "dt" in options.given:
        raise InputError("--hold and --dt auto both choose the substeps; give one of the two")
    return options


def begin_stable(sim: Simulation) -> None:
    """Have a simulation begin with the fewest substeps that are stable, where it has fewer."""
    from taichi_cloth.budgets.keeper import StableSteps

    least = StableSteps(sim).least()
    if least > sim.substeps:
        sim.set_step(substeps=least)


def without_its_steps(log: Log) -> Log:
    """A log without its own changes of what a budget chooses."""
    from taichi_cloth.ui.interaction import SET

    kept = {
        frame: [
            event
            for event in events
            if event.kind != SET.name or event.fields().get("name") not in (METHOD, *SETS)
        ]
        for frame, events in log.by_frame.items()
    }
    return replace(log, by_frame=kept)
