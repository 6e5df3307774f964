import gymnasium
import numpy as np
import pytest

from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.teleop.view import RerunView, make_view


class Twenty(gymnasium.Env):
    metadata = {"render_fps": 20}  # noqa: RUF012
    hand = LEAP


ENV = Twenty()
OBSERVATION = {
    "pixels": {"front": np.zeros((96, 96, 3), np.uint8)},
    "tactile": np.ones(240, np.float32),
    "fingertips": np.zeros(12, np.float32),
}
INFO = {"is_success": False, "progress": 0.5}
MOTION = Motion(np.full((4, 3), 0.01), np.full((4, 3), 0.005))


def watch(view, index, recorded, steps=3):
    view.begin(index, recorded)
    for _ in range(steps):
        view.watch(ENV, OBSERVATION, INFO, MOTION)
    view.end("kept", steps)


def test_every_attempt_becomes_a_recording_and_practice_none(tmp_path):
    view = RerunView("raw", tmp_path / "rerun")
    watch(view, 3, recorded=False)
    assert not (tmp_path / "rerun").exists()
    watch(view, 3, recorded=True)
    watch(view, 4, recorded=True)
    files = sorted((tmp_path / "rerun").iterdir())
    assert [file.name for file in files] == ["attempt_000003.rrd", "attempt_000004.rrd"]
    text = files[0].read_bytes()
    for entity in ("camera/front", "touch", "palm/draft", "palm/selected", "palm/measured", "outcome"):
        assert f"raw/{entity}".encode() in text


class FakeStream:
    """Stands for rerun's recording, whose viewer needs a display."""

    made: list = []  # noqa: RUF012

    def __init__(self, application, recording_id):
        self.recording_id, self.spawned, self.logged, self.last = recording_id, 0, [], {}
        self.made.append(self)

    def spawn(self):
        self.spawned += 1

    def set_time(self, *arguments, **options):
        pass

    def log(self, entity, value):
        self.logged.append(entity)
        self.last[entity] = value

    def flush(self):
        pass

    def disconnect(self):
        pass


@pytest.fixture
def viewer(monkeypatch):
    import rerun

    monkeypatch.setattr(FakeStream, "made", [])
    monkeypatch.setattr(rerun, "RecordingStream", FakeStream)
    return FakeStream.made


def test_the_viewer_shows_practice_too_each_run_as_a_recording(viewer):
    view = RerunView("raw", None)
    watch(view, 3, recorded=False)
    watch(view, 3, recorded=True)
    assert [stream.spawned for stream in viewer] == [1, 1]
    assert len({stream.recording_id for stream in viewer}) == 2
    assert {"raw/camera/front", "raw/touch", "raw/palm/draft"} <= set(viewer[0].logged)


def test_touch_is_shown_in_newtons_pad_by_pad_with_the_tips_up(viewer):
    view = RerunView("raw", None)
    view.begin(0, recorded=True)
    view.watch(ENV, OBSERVATION | {"tactile": np.arange(240, dtype=np.float32)}, INFO, None)
    picture = viewer[0].last["raw/touch"]
    values = np.frombuffer(bytes(picture.buffer.as_arrow_array().to_pylist()[0]), np.float32).reshape(10, 28)
    for finger, row, column in ((0, 0, 0), (1, 9, 5), (3, 2, 4)):
        assert values[9 - row, 7 * finger + column] == 60 * finger + 6 * row + column
    assert (values[:, 6::7] == 0).all()


@pytest.mark.parametrize(("headless", "folder"), [(True, None), (False, None), (False, "own"), (True, "own")])
def test_without_a_display_recordings_go_beside_the_dataset(tmp_path, monkeypatch, capsys, headless, folder):
    from lerobot.utils import keyboard_input

    monkeypatch.setattr(keyboard_input, "is_headless", lambda: headless)
    own = tmp_path / folder if folder else None
    view = make_view("raw", own, tmp_path / "live")
    assert view._folder == (own or (tmp_path / "live.rerun" if headless else None))
    told = capsys.readouterr().out
    assert (f"recordings for rerun go to {tmp_path / 'live.rerun'}" in told) == (headless and own is None)


def test_every_run_is_closed_with_its_outcome(viewer):
    view = RerunView("raw", None)
    view.begin(0, recorded=False)
    watch(view, 0, recorded=True)
    view.end("quit", 0)
    assert [stream.logged[-1] for stream in viewer] == ["raw/outcome", "raw/outcome"]
