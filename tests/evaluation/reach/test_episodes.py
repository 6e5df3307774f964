from degraded_fakes import chain, episode

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.evaluation.reach import episodes
from lerobot_dexflex.evaluation.reach.episodes import (
    BRANCHES,
    COLUMNS,
    chain_digest,
    episode_row,
    run_episodes,
)
from lerobot_dexflex.evaluation.reach.privileged import OperatorInterface
from lerobot_dexflex.experts.reach.chains import build_chain
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import explanation
from lerobot_dexflex.interfaces.raw import RawInterface


def test_a_row_has_every_column_and_what_was_measured():
    found = episode_row(episode(60, label=0.004, selected=0.001, event=range(40, 44), dropped=True))
    assert tuple(found) == COLUMNS
    assert (found["steps"], found["dropped"], found["duration"], found["progress"]) == (60, True, 0.25, 0.5)
    assert found["intent_event"] == 0.5
    assert found["around"] == " ".join(["0.50"] * 7 + ["nan"])  # 20 steps later it is over.
    assert found["chain"] == chain_digest(chain(0))


def test_nothing_is_said_of_removals_and_candidates_where_there_are_none():
    found = episode_row(episode())
    assert [found[name] for name in ("around", "intent_event", "intent_calm", *BRANCHES)] == [None] * (
        3 + len(BRANCHES)
    )


def test_branches_are_shares_of_the_steps_that_chose():
    assert set(BRANCHES) <= set(explanation.BRANCHES)
    found = episode()
    found.explanations = [{"branch": "draft"}, {"branch": "pure"}, {"branch": "draft"}, {}]
    made = episode_row(found)
    assert [made[name] for name in BRANCHES] == [0.6667, 0.3333, 0.0, 0.0]


def test_a_digest_tells_chains_apart():
    assert chain_digest(chain(1)) == chain_digest(chain(1)) != chain_digest(chain(2))


def test_a_conditions_source_reaches_the_loop(monkeypatch):
    asked = []

    def run_chains(chains, errors, interface, *, source, batch):
        asked.append((errors.name, source))
        return [episode() for _ in chains]

    monkeypatch.setattr(episodes, "run_chains", run_chains)
    for condition in ("noise_2mm", "noise_2mm+pressing+verified"):
        assert len(run_episodes([chain(1)], condition, RawInterface(LEAP), 1)) == 1
    assert asked == [("noise_2mm", "motion"), ("noise_2mm", "pressing")]


def test_the_operator_is_its_own_bound_whatever_happens_to_its_drafts(monkeypatch):
    monkeypatch.setattr("lerobot_dexflex.commands.loop.GOAL_STEPS", 2)  # Eight goals in sixteen steps.
    built = build_chain(ReachEnv(cameras=()), 50_003, verify=False)
    assert built is not None
    chains = [built]
    (wanted,) = run_episodes(chains, "clean", OperatorInterface(LEAP), 1)
    (found,) = run_episodes(chains, "noise_4mm+pressing", OperatorInterface(LEAP), 1)
    (spoilt,) = run_episodes(chains, "noise_4mm", RawInterface(LEAP), 1)
    assert wanted["steps"] == 16
    assert (found["progress"], found["retention"]) == (wanted["progress"], wanted["retention"])
    assert found["intent"] == 0
    assert spoilt["intent"] > 0
    assert spoilt["intervention"] == 0 < found["intervention"]
