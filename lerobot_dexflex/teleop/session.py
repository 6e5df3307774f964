"""A session: practise, record, decide, by key or hands-free, until enough is kept or the operator quits."""

from dataclasses import dataclass
from typing import Literal

import gymnasium

from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.recording.attempt import Take
from lerobot_dexflex.teleop.clock import TICK, Clock, beats
from lerobot_dexflex.teleop.hands import Hands
from lerobot_dexflex.teleop.keys import HELP, Keys
from lerobot_dexflex.teleop.leader import Leader, Say
from lerobot_dexflex.teleop.shelf import Shelf
from lerobot_dexflex.teleop.view import View

Phase = Literal["practice", "record", "decide"]
"""`practice`: the robot is led, nothing is kept. `record`: it is. `decide`: the episode is over and waits to
be kept or discarded; the simulation stands."""


@dataclass(frozen=True)
class Rules:
    """How a session goes."""

    episodes: int
    """To keep, with those that were kept before."""
    seed: int = 0
    """Attempt k starts from environment seed `seed + k`."""
    hands_free: bool = False
    """Whether episodes begin by themselves, and success decides."""
    max_steps: int = 0
    """Longest episode in control steps; 0 sets none."""


class Session:
    """What happens at keys, ticks and control steps.

    Args:
        env: The task, without a time limit of its own.
        leader: Who leads.
        hands: Make what executes commands.
        shelf: Where attempts go.
        keys: Of the operator.
        view: Who looks on.
        rules: How it goes.
        say: Tells the operator what happens.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        leader: Leader,
        hands: Hands,
        shelf: Shelf,
        keys: Keys,
        view: View,
        rules: Rules,
        say: Say,
    ) -> None:
        self._env, self._leader, self._hands, self._shelf = env, leader, hands, shelf
        self._keys, self._view, self._rules, self._say = keys, view, rules, say
        self.phase: Phase = "practice"
        self.over = shelf.kept >= rules.episodes
        """Whether the session is: enough is kept, the operator quits, or nobody leads any more."""
        self.ticks, self.late = 0, 0
        """Ticks so far, and how many of them came more than a tick late."""
        self._begin("practice")

    def run(self, clock: Clock) -> None:
        """Run until it is over."""
        for beat in beats(clock):
            if self.over:
                return
            self.ticks += 1
            self.late += beat.late > TICK
            self.tick(beat.now)
            if beat.control and not self.over:
                self.control()

    def tick(self, now: float) -> None:
        """Obey the keys and look at the stream; `now` is the caller's clock [s]."""
        for key in self._keys.pressed():
            self.press(key)
        self._leader.tick(now)

    def press(self, key: str) -> None:
        """Do what a key asks for, if that makes sense now."""
        match key.lower(), self.phase:
            case "space", _:
                self._leader.toggle()
            case "o", _:
                self._leader.calibrate()
            case "s", "practice":
                self._start()
            case "k" | "d", "record" | "decide" if self._take.steps:
                self._decide(kept=key.lower() == "k")
            case "q", _:
                self._quit()
            case _:
                self._say(HELP)

    def control(self) -> None:
        """Execute a control step, unless a decision is waited for."""
        if self.phase == "practice" and self._rules.hands_free and self._leader.ready:
            self._start()
        if self.phase != "decide":
            command = self._leader.command()
            over = command is None or self._step(command)
            if ending := self._ending(over):
                self._end(ending)

    def _step(self, command: Command) -> bool:
        over = self._take.step(command)
        self._view.watch(self._env, self._take.observation, self._take.info, self._hands.motion)
        return over

    def _ending(self, over: bool) -> str:
        """Return why the run is over, or nothing."""
        if self._take.success:
            return "success"
        if self._take.info.get("dropped"):
            return "dropped"
        if self.phase == "record" and self._take.steps == self._rules.max_steps:
            return "time out"
        return "no more commands" if over else ""

    def _end(self, ending: str) -> None:
        if self.phase == "practice" or not self._take.steps:
            self._begin("practice")
        elif self._rules.hands_free:
            self._decide(kept=self._take.success)
        else:
            self.phase = "decide"
            self._say(f"The episode is over: {ending}. k keeps it, d discards it.")
            return
        if self._leader.over:
            self._say("The stream has ended.")
            self.over = True

    def _begin(self, phase: Phase) -> None:
        """Reset the task to the next attempt's start."""
        index = self._shelf.next_index
        recorded = phase == "record"
        self._take = Take(self._env, self._rules.seed + index, self._hands(index), keep=recorded)
        self._leader.begin(self._env, index)
        self._view.begin(index, recorded)
        self.phase = phase

    def _start(self) -> None:
        if not self._leader.ready:
            self._say("Not yet: the hand is not calibrated.")
            return
        self._begin("record")
        self._say(f"Attempt {self._shelf.next_index} is recorded. k keeps it, d discards it.")

    def _decide(self, kept: bool) -> None:
        attempt = self._take.attempt(self._shelf.next_index, kept)
        self._view.end("success" if attempt.success else "kept" if kept else "discarded", attempt.steps)
        self._shelf.put(attempt)
        done, wanted = self._shelf.kept, self._rules.episodes
        solved = "solved" if attempt.success else "not solved"
        self._say(f"{'Kept' if kept else 'Discarded'} ({solved}): {done} of {wanted} episodes.")
        self.over = done >= wanted
        if not self.over:
            self._begin("practice")

    def _quit(self) -> None:
        if self.phase != "practice":
            self._say("The episode under way is not kept.")
        self._view.end("quit", self._take.steps)
        self.over = True
