import json

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.outcome import Outcome, Recorder
from lerobot_dexflex.evaluation.store import EPISODES, Store


def outcome(episode, group):
    return Recorder({"is_success": True, "progress": 1}, 0.05).outcome("raw", episode, episode, group)


def test_a_torn_line_costs_its_group_and_nothing_else(tmp_path):
    store = Store(tmp_path / "out", {"seed": 0}, Outcome.parse)
    store.append([outcome(0, (0, 2)), outcome(1, (0, 2))])
    store.append([outcome(2, (2, 4)), outcome(3, (2, 4))])
    file = store.root / EPISODES
    file.write_text(file.read_text()[:-20])
    assert [o.episode for o in store.load()] == [0, 1]
    store.append([outcome(2, (2, 4)), outcome(3, (2, 4))])
    assert [o.episode for o in store.load()] == [0, 1, 2, 3]


def test_an_episode_stored_twice_counts_once(tmp_path):
    store = Store(tmp_path / "out", {}, Outcome.parse)
    store.append([outcome(0, (0, 1))])
    store.append([outcome(0, (0, 1))])
    assert len(store.load()) == 1


def test_changed_settings_are_refused_by_name_and_lose_nothing(tmp_path):
    Store(tmp_path / "out", {"seed": 0, "checkpoint.draft": "abc"}, Outcome.parse).append(
        [outcome(0, (0, 1))]
    )
    with pytest.raises(DexFlexError, match=r"checkpoint\.draft: 'abc' in the folder, 'xyz' now") as error:
        Store(tmp_path / "out", {"seed": 0, "checkpoint.draft": "xyz"}, Outcome.parse)
    assert "seed" not in str(error.value)
    assert len(Store(tmp_path / "out", {"seed": 0, "checkpoint.draft": "abc"}, Outcome.parse).load()) == 1


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(DexFlexError, match="no comparison"):
        Store(tmp_path, {}, Outcome.parse)
    with pytest.raises(DexFlexError, match="is a file"):
        Store(tmp_path / "thesis.tex", {}, Outcome.parse)


def test_sessions_are_remembered_beside_the_settings(tmp_path):
    store = Store(tmp_path / "out", {"seed": 7}, Outcome.parse)
    store.add_session({"commit": "abc"})
    assert store.sessions() == [{"commit": "abc"}]
    assert json.loads((tmp_path / "out/settings.json").read_text())["identity"] == {"seed": 7}
