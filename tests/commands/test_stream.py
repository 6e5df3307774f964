"""What each corruption does to a stream, and that bad names are refused."""

import numpy as np
import pytest

from lerobot_dexflex.commands.corruption import EVENT_STEPS, Corruption
from lerobot_dexflex.errors import DexFlexError

CLEAN = 1e-3 * np.arange(12, dtype=np.float64).reshape(4, 3)
LOADS = np.array([0.2, 3.0, 1.0, 2.0])
INWARD = np.tile([1.0, 0.0, 0.0], (4, 1))
NAMES = ["clean", "noise_2mm", "scale_1.5", "delay_2", "removal_3mm", "bias_1mm"]


def run(name: str, steps: int = 100, seed: int = 0) -> np.ndarray:
    stream = Corruption.parse(name).stream(np.random.default_rng(seed))
    return np.stack([stream.step(np.multiply(k + 1.0, CLEAN), LOADS, INWARD) for k in range(steps)])


CLEAN_RUN = np.stack([CLEAN * (k + 1) for k in range(100)])


@pytest.mark.parametrize("name", NAMES)
def test_names_round_trip(name):
    assert Corruption.parse(name).name == name


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_stream(name):
    np.testing.assert_array_equal(run(name), run(name))


def test_clean_commands_pass():
    np.testing.assert_array_equal(run("clean"), CLEAN_RUN)


def test_noise_is_uniform_and_new_at_every_step():
    noise = run("noise_2mm", 100) - CLEAN_RUN
    assert np.abs(noise).max() <= 0.002
    assert noise.std() == pytest.approx(0.004 / np.sqrt(12), rel=0.05)
    assert abs(np.corrcoef(noise[1:].ravel(), noise[:-1].ravel())[0, 1]) < 0.1


def test_bias_is_the_same_at_every_step():
    bias = run("bias_1mm") - CLEAN_RUN
    np.testing.assert_allclose(bias, np.broadcast_to(bias[0], bias.shape), atol=1e-12)
    assert 0 < np.abs(bias).max() <= 0.001


def test_scaling_multiplies():
    np.testing.assert_allclose(run("scale_1.5"), 1.5 * CLEAN_RUN)


def test_delay_repeats_the_first_command_and_then_lags_two_steps():
    delayed = run("delay_2")
    np.testing.assert_array_equal(delayed[:3], np.broadcast_to(CLEAN_RUN[0], (3, 4, 3)))
    np.testing.assert_array_equal(delayed[2:], CLEAN_RUN[:-2])


def test_removal_pulls_the_most_loaded_finger_off_for_eight_steps_about_every_25():
    removed = run("removal_3mm")
    changed = np.abs(removed - CLEAN_RUN).max(2) > 0
    assert not changed[:, [0, 2, 3]].any()
    np.testing.assert_allclose(removed[changed[:, 1], 1], np.tile([-0.003, 0, 0], (changed[:, 1].sum(), 1)))
    edges = np.diff(np.concatenate([[0], changed[:, 1].astype(int), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    assert 3 <= len(starts) <= 6
    assert set((ends - starts)[:-1]) == {EVENT_STEPS}
    assert 7 <= starts[0] <= 19


@pytest.mark.parametrize("name", ["typo_2mm", "noise_xmm", "noise", "delay_1.5", "scale_-1"])
def test_what_is_no_corruption_is_refused(name):
    with pytest.raises(DexFlexError, match=r"corruption|strength"):
        Corruption.parse(name)
