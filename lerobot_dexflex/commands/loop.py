"""The closed loop: operator, spoilt command, interface, hand; batched over chains of goals.

Each slot of a batch runs one chain; when it ends the next chain takes its place, so learned interfaces
always see full batches. At every step the operator looks at the state that was actually reached, its clean
displacement is spoilt, and the draft is the spoilt displacement held over the horizon: an operator
with a glove knows no future. What a method changes, the operator notices.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, Seed, seeds_of
from lerobot_dexflex.conventions import DRAFT_HORIZON, LEROBOT_KEYS
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import MAX_STEPS, STEADY_STEPS, TOLERANCE, Chain, HeldObject
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.interfaces.protocol import Interface

Array = NDArray[np.float64]

GOAL_STEPS = 60
"""After so many steps the next goal is set, with partial credit for this one."""
SNAPSHOT_EVERY = 8
"""Control steps between two snapshots of a recorded episode."""
DROP_DISTANCE, DROP_STEPS = 0.08, 8
"""An object is dropped this far from the start [m] or after so many steps with fewer than two loaded tips."""
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
    """What happened in one chain. T = steps run; tips in the palm frame."""

    chain: Chain
    errors: CommandErrors
    dropped: bool = False
    goals_reached: int = 0
    progress: float = 0.0
    """Goals reached plus partial credit of the others, over all goals."""
    label: Array = field(default_factory=lambda: np.zeros((0, 4, 3)))
    """Clean command u* at the state reached [m]. Shape (T, 4, 3)."""
    draft: Array = field(default_factory=lambda: np.zeros((0, 4, 3)))
    """Spoilt command [m]. Shape (T, 4, 3)."""
    executed: Array = field(default_factory=lambda: np.zeros((0, 4, 3)))
    """Executed displacement of the commanded tips [m]. Shape (T, 4, 3)."""
    loads: Array = field(default_factory=lambda: np.zeros((0, 4)))
    """Normal force of each tip before the step [N]. Shape (T, 4)."""
    in_event: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    """Whether an event (removal, freeze, dropout) was going on. Shape (T,)."""
    events: list[ErrorEvent] = field(default_factory=list)
    """What went wrong now and then: family, onset, end, finger."""
    goal_error: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """Distance [m] and angle [rad] to the goal after the step. Shape (T, 2)."""
    explanations: list[Any] = field(default_factory=list)
    """The interface's explanation of each step, where it gives one."""
    rows: dict[str, NDArray] = field(default_factory=dict)
    """Observations and commands of every step, if they were recorded; keys as in the corpus schema."""

    @property
    def steps(self) -> int:
        """Control steps run."""
        return len(self.label)


class Slot:
    """One running chain."""

    def __init__(self, env: ReachEnv, chain: Chain, errors: CommandErrors) -> None:
        self.held = HeldObject(env, chain.seed, chain.episode)
        self.episode = Episode(chain, errors)
        self.state: HandState = self.held.senses.read()
        self.observation = self.held.observation
        self._home = self.held.home
        self._goal = -1
        self._series: dict[str, list[Any]] = {}
        self._loose = 0
        self._next_goal()

    @property
    def steps(self) -> int:
        """Control steps run so far."""
        return len(self._series.get("label", ()))

    def ask(self, tips: Array) -> Array:
        """Return the operator's clean displacement [m] (4, 3).

        Args:
            tips: Commanded fingertips before the step [m]. Shape (4, 3).
        """
        self._tips = tips
        self.label = self.held.operator.displacement(tips, self.state)
        return self.label

    def spoil(self, draft: Array, in_event: bool) -> None:
        """Note what is left of the displacement [m] (4, 3), and whether an event is going on."""
        self._keep(label=self.label, draft=draft, loads=self.state.loads, in_event=in_event)

    def advance(self, joints: Array, tips: Array, explanation: Any, record: bool) -> bool:
        """Execute joints [rad] (16,) that put the commanded tips at `tips` [m] (4, 3); say if it goes on."""
        before, env = self.observation, self.held.env
        if record:
            previous = self.held.joints
            self._keep(
                joints=before["agent_pos"],
                fingertips=before["fingertips"],
                gravity=before["gravity"],
                tactile=before["tactile"],
                command=self._tips,
                joint_targets=joints,
                label_joints=kernels.solve_fingertips(self._tips + self.label, previous),
                snapshot_physics=env.physics_state() if (self.steps - 1) % SNAPSHOT_EVERY == 0 else None,
            )
        self.held.joints, self.held.command = joints, tips
        env.advance(joints)
        self.observation, self.state = env.observe(), self.held.senses.read()
        self._keep(executed=tips - self._tips)
        if explanation is not None:
            self.episode.explanations.append(explanation)
        return self._judge()

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
        self._keep(goal_error=(distance, angle), lost=bool(lost or far))
        self._goal_steps += 1
        if far or self._loose >= DROP_STEPS:
            episode.dropped = True
            return False
        reached = self._steady >= STEADY_STEPS
        if reached or self._goal_steps >= GOAL_STEPS:
            episode.goals_reached += reached
            episode.progress += 1.0 if reached else self._partial()
            return self._next_goal()
        return True

    def finish(self, events: Sequence[ErrorEvent] = ()) -> Episode:
        """Return the episode with its series as arrays, and with the events of its errors."""
        episode, series = self.episode, self._series
        episode.events = list(events)
        if self._goal < len(episode.chain.goals):
            episode.progress += self._partial()
        episode.progress /= len(episode.chain.goals)
        for key in ("label", "draft", "executed", "loads", "in_event", "goal_error"):
            setattr(episode, key, np.array(series.pop(key)))
        snapshots = series.pop("snapshot_physics", [])
        episode.rows = {key: np.array(values) for key, values in series.items()}
        kept = [k for k, physics in enumerate(snapshots) if physics is not None]
        if kept:
            episode.rows["snapshot_step"] = np.array(kept)
            episode.rows["snapshot_physics"] = np.stack([snapshots[k] for k in kept])
        return episode

    def _next_goal(self) -> bool:
        self._goal += 1
        goals = self.episode.chain.goals
        if self._goal >= len(goals):
            return False
        goal = goals[self._goal]
        self._pose = np.array(goal.position), np.array(goal.quaternion)
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
    seed: int = 0,
    batch: int = 16,
    max_steps: int = MAX_STEPS,
    record: bool = False,
    teacher: Callable[[np.random.Generator], Iterator[bool]] | None = None,
    watch: Callable[[int, Slot], None] | None = None,
) -> list[Episode]:
    """Run one episode per chain and return them in the order of the chains.

    Everything random about an episode follows from its chain's seed and `seed`, so that methods meet the
    same starts, goals and errors.

    Args:
        chains: Starts and goals.
        errors: What goes wrong with the commands, for all or for each chain.
        interface: The method under test.
        seed: Further seed of the errors.
        batch: Number of hands that are simulated side by side.
        max_steps: Time limit in control steps.
        record: Whether to keep observations and commands in `Episode.rows`.
        teacher: Begins, for each episode, a stream that says at which steps the clean command is executed
            instead of the draft. Only for interfaces that execute drafts as they are.
        watch: Called with the chain's index and its slot after each step, to film or log it.
    """
    spoilt = [errors] * len(chains) if isinstance(errors, CommandErrors) else list(errors)
    batch = min(batch, len(chains))
    environments = [ReachEnv(cameras=()) for _ in range(batch)]
    waiting = iter(range(len(chains)))
    finished: dict[int, Episode] = {}
    slots: list[Slot | None] = [None] * batch
    stream = ErrorStream(batch)
    numbers, teachers = [-1] * batch, [_never()] * batch
    observations: list[dict[str, NDArray]] = [{}] * batch
    initial = np.zeros((batch, 16))
    interface.reset()
    while True:
        fresh = np.zeros(batch, bool)
        for k in range(batch):
            if slots[k] is None and (n := next(waiting, None)) is not None:
                slot = slots[k] = Slot(environments[k], chains[n], spoilt[n])
                stream.begin(k, spoilt[n], _seeds(spoilt[n], chains[n].seed, seed))
                numbers[k], fresh[k], initial[k] = n, True, slot.held.joints
                observations[k] = slot.observation
                if teacher:
                    teachers[k] = teacher(np.random.default_rng((chains[n].seed, seed, 11)))
        running = [(k, slot) for k, slot in enumerate(slots) if slot is not None]
        if not running:
            return [finished[n] for n in range(len(chains))]
        if fresh.any():
            interface.reset(torch.from_numpy(fresh))
        stacked = stack_observations(observations)
        tips = interface.start(stacked, torch.from_numpy(initial)).numpy().copy()
        drafts = _drafts(running, stream, tips)
        for k, slot in running:
            if next(teachers[k]):
                drafts[k] = slot.label
        if isinstance(interface, Privileged):
            interface.see(slots)
        draft = torch.from_numpy(drafts)[:, None].expand(-1, DRAFT_HORIZON, -1, -1)
        joints = interface.step(stacked, draft).numpy()
        command = interface.command
        assert command is not None
        explanations = getattr(interface, "explanation", None)
        for k, slot in running:
            explanation = None if explanations is None else explanations.row(k)
            goes_on = slot.advance(joints[k], command[k].numpy(), explanation, record)
            observations[k] = slot.observation
            if watch:
                watch(numbers[k], slot)
            if not goes_on or slot.steps >= max_steps:
                finished[numbers[k]] = slot.finish([e for e in stream.events if e.row == k])
                slots[k] = None


def _drafts(running: Sequence[tuple[int, Slot]], stream: ErrorStream, tips: Array) -> Array:
    """Ask every operator and spoil the answers [m] (batch, 4, 3); ended rows stand still."""
    clean, loads, inward = np.zeros_like(tips), np.zeros(tips.shape[:2]), np.zeros_like(tips)
    for k, slot in running:
        clean[k], loads[k], inward[k] = slot.ask(tips[k]), slot.state.loads, slot.state.inward
    motion = stream.delayed(torch.from_numpy(clean))[:, None]
    spoilt = stream.step(motion, torch.from_numpy(loads), torch.from_numpy(inward))[:, 0].numpy()
    drafts, in_event = np.zeros_like(tips), stream.in_event
    for k, slot in running:
        drafts[k] = spoilt[k]
        slot.spoil(spoilt[k].copy(), bool(in_event[k]))
    return drafts


def _seeds(errors: CommandErrors, chain: int, seed: int) -> list[Seed]:
    """Return the seeds of an episode's errors; that of the first is as old as the benchmark."""
    first = (chain, seed, 7)
    return [first, *seeds_of(errors, first)[1:]][: len(errors.errors)]


def stack_observations(observations: Sequence[Mapping[str, NDArray]]) -> dict[str, torch.Tensor]:
    """Return the observations of several hands as an interface reads them, one row each."""
    return {
        name: torch.from_numpy(np.stack([one[key] for one in observations]))
        for key, name in LEROBOT_KEYS.items()
    }


def _never() -> Iterator[bool]:
    while True:
        yield False
