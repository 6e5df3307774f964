import numpy as np

from lerobot_dexflex.evaluation.report.film import read_mp4, side_by_side, write_mp4


def grey(value, frames, width=32):
    return [np.full((32, width, 3), value, np.uint8)] * frames


def test_a_film_comes_back_with_its_frames_and_brightness(tmp_path):
    write_mp4(tmp_path / "a.mp4", grey(120, 5), crf=18)
    film = read_mp4(tmp_path / "a.mp4")
    assert film.shape == (5, 32, 32, 3)
    assert np.abs(film.astype(int) - 120).max() < 6


def test_films_stand_side_by_side_and_the_shorter_one_waits(tmp_path):
    write_mp4(tmp_path / "bright.mp4", grey(200, 3), crf=18)
    write_mp4(tmp_path / "dark.mp4", grey(60, 7), crf=18)
    side_by_side([tmp_path / "bright.mp4", tmp_path / "dark.mp4"], tmp_path / "both.mp4")
    both = read_mp4(tmp_path / "both.mp4")
    assert both.shape == (7, 32, 32 + 6 + 32, 3)
    assert both[-1, :, 4:28].mean() > 185
    assert both[-1, :, 42:66].mean() < 75
