import numpy as np
import pytest

from lerobot_dexflex.evaluation.outcome import COLUMNS, Motion, Recorder


def info(progress, success=False, dropped=False, holding=False):
    return {"is_success": success, "progress": progress, "dropped": dropped, "holding": holding}


def record(*steps, motions=None):
    recorder = Recorder(info(0.0), period=0.05, limit=10)
    for k, step in enumerate(steps):
        recorder.add(step, motions[k] if motions else None)
    return recorder.outcome("raw", 1003)


def test_an_episode_is_counted_step_by_step():
    outcome = record(
        info(0.5, holding=True), info(0.5, holding=True), info(0.25, dropped=True), info(1.0, success=True)
    )
    assert outcome.steps == 4
    assert outcome.seconds == pytest.approx(0.2)
    assert (outcome.progress, outcome.progress_final) == (1.0, 1.0)
    assert (outcome.drops, outcome.holding) == (1, 0.5)
    assert outcome.ending == "success"


def test_holding_is_normalised_by_the_time_from_the_first_grasp_to_success_or_time_limit():
    held, lost = info(0.5, holding=True), info(0.5)
    assert record(lost, held, lost, held, info(1.0, success=True, holding=True)).nht == pytest.approx(3 / 4)
    # A drop ends the episode; until the limit of ten steps nothing is held.
    assert record(lost, held, held, info(0.5, dropped=True)).nht == pytest.approx(2 / 9, abs=1e-4)
    assert record(lost, lost).nht == 0.0
    assert Recorder({"is_success": False, "progress": 0}, 0.05, 10).outcome("joint", 0).nht is None


def test_lying_on_the_floor_for_long_is_one_drop():
    outcome = record(info(0, dropped=True), info(0, dropped=True), info(0), info(0, dropped=True))
    assert outcome.drops == 2
    assert outcome.ending == "dropped"


def test_what_a_task_does_not_report_stays_undefined():
    recorder = Recorder({"is_success": False, "progress": 0}, period=0.05, limit=10)
    recorder.add({"is_success": False, "progress": 0}, None)
    outcome = recorder.outcome("joint", 0)
    assert (outcome.drops, outcome.holding, outcome.intervention) == (None, None, None)
    assert outcome.ending == "time out"


def test_intervention_is_the_mean_relative_change_of_the_draft():
    draft = np.zeros((4, 3))
    draft[0, 0] = 0.003
    half, opposite = Motion(draft, 0.5 * draft), Motion(draft, -draft)
    # 0.0015 / 0.003001 and 0.006 / 0.003001
    outcome = record(info(0), info(0), motions=[half, opposite])
    assert outcome.intervention == pytest.approx((0.0015 + 0.006) / 0.003001 / 2, abs=1e-4)


def test_interventions_around_contacts_are_told_from_those_in_calm():
    draft = np.full((4, 3), 0.001)
    changed, same = Motion(draft, 0.5 * draft), Motion(draft, draft)
    touching, free = np.array([True] * 2), np.array([True, False])
    # The finger touches from step 20 on: the steps 15 to 25 are around that event.
    states = [free] * 21 + [touching] * 20
    recorder = Recorder(info(0.0) | {"contacts": states[0]}, period=0.05, limit=10)
    for k, state in enumerate(states[1:]):
        step = info(0.0, holding=k >= 5) | {"contacts": state}
        recorder.add(step, changed if 15 <= k <= 25 else same)
    outcome = recorder.outcome("dexflex", 0)
    assert outcome.intervention_event == pytest.approx(0.5, abs=1e-3)
    assert outcome.intervention_calm == 0
    assert outcome.change_event == pytest.approx(0.5 * np.sqrt(3), abs=1e-4)
    assert outcome.change_calm == 0
    assert outcome.intervention == pytest.approx(0.5 * 11 / 40, abs=1e-3)


def test_without_contacts_or_drafts_nothing_is_told_of_them():
    with_motion = record(info(0), motions=[Motion(np.ones((4, 3)), np.zeros((4, 3)))])
    assert with_motion.intervention_event is None
    recorder = Recorder(info(0.0) | {"contacts": np.ones(2, bool)}, period=0.05, limit=10)
    recorder.add(info(0.0, holding=True) | {"contacts": np.ones(2, bool)}, None)
    assert recorder.outcome("joint", 0).intervention_calm is None


def test_a_row_holds_the_columns_and_nothing_else():
    row = record(info(0.123456), info(1.0, success=True)).row()
    assert tuple(row) == COLUMNS
    assert (row["success"], row["steps"], row["seconds"], row["progress"]) == (True, 2, 0.1, 1.0)
    assert record(info(0.123456)).row()["progress_final"] == 0.1235
