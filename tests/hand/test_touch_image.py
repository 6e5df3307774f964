import numpy as np

from lerobot_dexflex.hand.touch_image import touch_strip
from lerobot_dexflex.hands import LEAP


def test_the_strip_shows_four_pads_with_their_tips_up():
    taxels = np.zeros((4, 10, 6))
    taxels[3, 9, 0] = 1.0  # thumb, row nearest the tip, first column
    strip = touch_strip(LEAP, taxels, full_scale=0.5, cell=8, gap=4)
    assert strip.shape == (80, 4 * 48 + 3 * 4, 3)
    assert strip.dtype == np.uint8
    rows, columns = np.nonzero((strip == touch_strip(LEAP, np.ones((4, 10, 6)))[0, 0]).all(axis=-1))
    assert (rows.min(), rows.max()) == (0, 7)
    assert (columns.min(), columns.max()) == (3 * 52, 3 * 52 + 7)
    assert (strip[:, 48:52] == 128).all()


def test_the_strip_has_one_scale_for_all_frames():
    weak, strong = (touch_strip(LEAP, np.full(240, force))[0, 0].astype(int).sum() for force in (0.05, 0.25))
    assert 0 < weak < strong
    assert np.array_equal(touch_strip(LEAP, np.full(240, 0.3)), touch_strip(LEAP, np.full(240, 5.0)))
