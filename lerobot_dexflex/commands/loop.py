"""The closed loop: operator, spoilt draft, interface, hand; batched over chains of goals.

Each slot of a batch runs one chain; when it ends the next chain takes its place, so learned interfaces
always see full batches. At every step the operator looks at the state that was actually reached and says
where the fingertips should be over the next steps; errors spoil that draft, the method executes its first
step, and what the method changes, the operator notices.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.commands.stream import ErrorStream, Seed, seeds_of
from lerobot_dexflex.conventions import DRAFT_HORIZON, LEROBOT_KEYS
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import MAX_STEPS, STEADY_STEPS, TOLERANCE, Chain, HeldObject
from lerobot_dexflex.experts.reach.operator import Guidance
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.protocol import Interface

Array = NDArray[np.float64]

GOAL_STEPS = 60
"""After so many steps the next goal is set, with partial credit for this one."""
DROP_DISTANCE, DROP_STEPS = 0.08, 8
"""An object is dropped this far from the start [m] or after so many steps with fewer than two loaded tips."""
PRESSING = (0.5, 2.0)
"""Range of a pressing source's squeeze, in units of what is needed; drawn per episode."""
_FLOOR = 0.5
"""Error, in tolerances summed, that counts as arrived in the partial credit."""


@runtime_checkable
class Privileged(Protocol):
    """An interface that looks into the simulator: upper bounds only."""

    def see(self, slots: Sequence["Slot | None"]) -> None:
        """Look at the running episodes; row k of the batch is slot k. Called before each `step`."""
        ...


@dataclass
class Episode:
    """What happened in one chain. T = steps run; motions from where tips are measured, in the palm frame."""

    chain: Chain
    errors: CommandErrors
    dropped: bool = False
    goals_reached: int = 0
    progress: float = 0.0
    """Goals reached plus partial credit of the others, over all goals."""
    progress_at: Array = field(default_factory=lambda: np.zeros(0))
    """The same after each step, as if the episode had ended there. Shape (T,)."""
    goal_steps: list[int] = field(default_factory=list)
    """Steps that each reached goal took."""
    label: Array = field(default_factory=lambda: np.zeros(0))
    """First step of the clean draft, without any squeeze [m]. Shape (T, fingers, 3)."""
    draft: Array = field(default_factory=lambda: np.zeros(0))
    """First step of the spoilt draft [m]. Shape (T, fingers, 3)."""
    selected: Array = field(default_factory=lambda: np.zeros(0))
    """Motion that the interface asked of the hand, beside its grip [m]. Shape (T, fingers, 3)."""
    loads: Array = field(default_factory=lambda: np.zeros(0))
    """Normal force of each tip before the step [N]. Shape (T, fingers)."""
    in_event: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    """Whether an event (removal, freeze, dropout, a lost finger) was going on. Shape (T,)."""
    events: list[ErrorEvent] = field(default_factory=list)
    """What went wrong now and then: family, onset, end, finger."""
    goal_error: Array = field(default_factory=lambda: np.zeros(0))
    """Distance [m] and angle [rad] to the goal after the step. Shape (T, 2)."""
    explanations: list[Any] = field(default_factory=list)
    """The interface's explanation of each step, where it gives one."""

    @property
    def steps(self) -> int:
        """Control steps run."""
        return len(self.label)


class Slot:
    """One running chain."""

    def __init__(
        self, env: ReachEnv, chain: Chain, errors: CommandErrors, squeeze: float | None = None
    ) -> None:
        self.held = HeldObject(env, chain.seed, chain.episode)
        self.episode = Episode(chain, errors)
        self.state: HandState = self.held.senses.read()
        self.observation = self.held.observation
        self.guidance: Guidance | None = None
        self._squeeze = squeeze
        self._home = self.held.home
        self._goal = -1
        self._series: dict[str, list[Any]] = {}
        self._loose = 0
        self._next_goal()

    @property
    def steps(self) -> int:
        """Control steps run so far."""
        return len(self._series.get("label", ()))

    def ask(self) -> Array:
        """Return the operator's clean draft [m] (8, fingers, 3)."""
        guidance = self.guidance = self.held.operator.guide(self.state)
        tips = self.state.tips
        motion = guidance.tips - tips
        self._keep(label=motion[0])
        if self._squeeze is None:
            return motion
        pressed = kernels.fingertips(self.held.env.hand.tables, guidance.joints) - guidance.tips[0]
        return motion + self._squeeze * pressed

    def spoil(self, draft: Array, in_event: bool) -> None:
        """Note what is left of the draft's first step [m] (fingers, 3), and whether an event is going on."""
        self._keep(draft=draft, loads=self.state.loads, in_event=in_event)

    def advance(self, joints: Array, selected: Array, explanation: Any) -> bool:
        """Execute joints [rad], which move the tips by `selected` [m] (fingers, 3); say if it goes on."""
        self.state = self.held.execute(joints)
        self.observation = self.held.env.observe()
        self._keep(selected=selected)
        if explanation is not None:
            self.episode.explanations.append(explanation)
        goes_on = self._judge()
        self._keep(progress_at=self._progress())
        return goes_on

    def _keep(self, **values: Any) -> None:
        for key, value in values.items():
            self._series.setdefault(key, []).append(value)

    def _judge(self) -> bool:
        episode, state = self.episode, self.state
        distance, angle = pose_error(state.position, state.quaternion, *self._pose)
        self._least = min(self._least, self._measure(distance, angle))
        self._steady = self._steady + 1 if distance < TOLERANCE[0] and angle < TOLERANCE[1] else 0
        lost = (state.loads > CONTACT_FORCE).sum() < 2
        self._loose = self._loose + 1 if lost else 0
        far = np.linalg.norm(state.position - self._home) > DROP_DISTANCE
        self._keep(goal_error=(distance, angle))
        self._goal_steps += 1
        if far or self._loose >= DROP_STEPS:
            episode.dropped = True
            return False
        reached = self._steady >= STEADY_STEPS
        if reached or self._goal_steps >= GOAL_STEPS:
            episode.goals_reached += reached
            if reached:
                episode.goal_steps.append(self._goal_steps)
            episode.progress += 1.0 if reached else self._partial()
            return self._next_goal()
        return True

    def finish(self, events: Sequence[ErrorEvent] = ()) -> Episode:
        """Return the episode with its series as arrays, and with the events of its errors."""
        episode, series = self.episode, self._series
        episode.events = list(events)
        episode.progress = self._progress()
        for key in ("label", "draft", "selected", "loads", "in_event", "goal_error", "progress_at"):
            setattr(episode, key, np.array(series.pop(key)))
        return episode

    def _progress(self) -> float:
        """Return the progress so far, with partial credit for the goal in hand."""
        goals = len(self.episode.chain.goals)
        return (self.episode.progress + (self._partial() if self._goal < goals else 0.0)) / goals

    def _next_goal(self) -> bool:
        self._goal += 1
        goals = self.episode.chain.goals
        if self._goal >= len(goals):
            return False
        goal = goals[self._goal]
        self._pose = goal.pose
        self.held.set_goal(self._goal, goal)
        self._first = self._least = self._measure(
            *pose_error(self.state.position, self.state.quaternion, *self._pose)
        )
        self._goal_steps = self._steady = 0
        return True

    def _partial(self) -> float:
        return float(np.clip((self._first - self._least) / max(self._first - _FLOOR, 1e-6), 0.0, 1.0))

    @staticmethod
    def _measure(distance: float, angle: float) -> float:
        return distance / TOLERANCE[0] + angle / TOLERANCE[1]


def run_chains(
    chains: Sequence[Chain],
    errors: CommandErrors | Sequence[CommandErrors],
    interface: Interface,
    *,
    source: Source = "motion",
    seed: int = 0,
    batch: int = 16,
    max_steps: int = MAX_STEPS,
    watch: Callable[[int, Slot], None] | None = None,
) -> list[Episode]:
    """Run one episode per chain and return them in the order of the chains.

    Everything random about an episode follows from its chain's seed and `seed`, so that methods meet the
    same starts, goals and errors.

    Args:
        chains: Starts and goals, found with the hand of the interface.
        errors: What goes wrong with the drafts, for all or for each chain.
        interface: The method under test.
        source: What a draft says.
        seed: Further seed of the errors.
        batch: Number of hands that are simulated side by side.
        max_steps: Time limit in control steps.
        watch: Called with the chain's index and its slot after each step, to film or log it.
    """
    spoilt = [errors] * len(chains) if isinstance(errors, CommandErrors) else list(errors)
    batch = min(batch, len(chains))
    hand = interface.hand
    environments = [ReachEnv(cameras=(), hand=hand) for _ in range(batch)]
    waiting = iter(range(len(chains)))
    finished: dict[int, Episode] = {}
    slots: list[Slot | None] = [None] * batch
    stream = ErrorStream(hand, batch)
    numbers = [-1] * batch
    observations: list[dict[str, NDArray]] = [{}] * batch
    interface.reset()
    while True:
        fresh = np.zeros(batch, bool)
        for k in range(batch):
            if slots[k] is None and (n := next(waiting, None)) is not None:
                chain = chains[n]
                slot = slots[k] = Slot(environments[k], chain, spoilt[n], _squeeze(source, chain.seed, seed))
                stream.begin(k, spoilt[n], _seeds(spoilt[n], chain.seed, seed))
                numbers[k], fresh[k] = n, True
                observations[k] = slot.observation
        running = [(k, slot) for k, slot in enumerate(slots) if slot is not None]
        if not running:
            return [finished[n] for n in range(len(chains))]
        if fresh.any():
            interface.reset(torch.from_numpy(fresh))
        draft = torch.from_numpy(_drafts(hand, running, stream, batch))
        if isinstance(interface, Privileged):
            interface.see(slots)
        joints = interface.step(stack_observations(observations), draft).numpy()
        assert interface.motion is not None
        selected = interface.motion.numpy()
        explanations = getattr(interface, "explanation", None)
        for k, slot in running:
            explanation = None if explanations is None else explanations.row(k)
            goes_on = slot.advance(joints[k], selected[k], explanation)
            observations[k] = slot.observation
            if watch:
                watch(numbers[k], slot)
            if not goes_on or slot.steps >= max_steps:
                finished[numbers[k]] = slot.finish([e for e in stream.events if e.row == k])
                slots[k] = None


def _drafts(hand: Hand, running: Sequence[tuple[int, Slot]], stream: ErrorStream, batch: int) -> Array:
    """Ask every operator and spoil the answers [m] (batch, 8, fingers, 3); ended rows stand still."""
    shape = batch, hand.n_fingers, 3
    clean, tips = np.zeros((batch, DRAFT_HORIZON, *shape[1:])), np.zeros(shape)
    loads, inward = np.zeros(shape[:2]), np.zeros(shape)
    for k, slot in running:
        clean[k], tips[k] = slot.ask(), slot.state.tips
        loads[k], inward[k] = slot.state.loads, slot.state.inward
    targets = stream.delayed(torch.from_numpy(tips[:, None] + clean))
    felt = torch.from_numpy(tips)
    spoilt = stream.step(targets - felt[:, None], felt, torch.from_numpy(loads), torch.from_numpy(inward))
    found, in_event = spoilt.numpy().copy(), stream.in_event
    for k, slot in running:
        slot.spoil(found[k, 0].copy(), bool(in_event[k]))
    return found


def _squeeze(source: Source, chain: int, seed: int) -> float | None:
    """Return by how much an episode's source presses; None for one of motion."""
    if source == "motion":
        return None
    return float(np.random.default_rng((chain, seed, 23)).uniform(*PRESSING))


def _seeds(errors: CommandErrors, chain: int, seed: int) -> list[Seed]:
    """Return the seeds of an episode's errors; that of the first is as old as the benchmark."""
    first = (chain, seed, 7)
    found = seeds_of(errors, first)
    return [first, *found[1:]] if found else []


def stack_observations(observations: Sequence[Mapping[str, NDArray]]) -> dict[str, torch.Tensor]:
    """Return the observations of several hands as an interface reads them, one row each."""
    return {
        name: torch.from_numpy(np.stack([one[key] for one in observations]))
        for key, name in LEROBOT_KEYS.items()
    }
