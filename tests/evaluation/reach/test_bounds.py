from typing import Any

import numpy as np
import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.bounds import teacher_of
from lerobot_dexflex.evaluation.reach.cells import Cell
from lerobot_dexflex.evaluation.reach.oracle import FEW
from lerobot_dexflex.evaluation.reach.plots import main_methods
from lerobot_dexflex.interfaces import Method
from lerobot_dexflex.runs.provenance import imported


def test_the_clean_operator_is_raw_with_a_teacher_at_every_step():
    method = Method.parse("clean")
    teacher = teacher_of(method)
    assert teacher is not None
    stream = teacher(np.random.default_rng(0))
    assert [next(stream) for _ in range(3)] == [True] * 3
    assert method.make().name == "clean"
    assert method.modules == Method.parse("raw").modules
    assert teacher_of(Method.parse("raw")) is None


def test_the_oracle_takes_its_reference_first_and_settings_of_selection(controller_folder):
    method = Method.parse("oracle:moving=2+clean")
    assert method.name == "oracle:clean+moving=2"
    assert method.options == (("reference", "clean"), ("moving", 2))
    oracle: Any = method.make(controller_folder)
    assert (oracle._reference, oracle._moving, oracle.settings) == ("clean", 2, FEW)
    oracle = Method.parse("oracle:n_pure=3").make(controller_folder)
    assert oracle.settings == SelectionSettings(n_pure=3)
    with pytest.raises(DexFlexError, match=r"`reference` must be 'draft' or 'clean'\. Got 'luck'"):
        Method.parse("oracle:luck").make(controller_folder)


def test_the_oracles_version_follows_its_own_module_too():
    modules = imported(Method.parse("oracle").modules)
    assert {"lerobot_dexflex.evaluation.reach.oracle", "lerobot_dexflex.interfaces.learned"} <= set(modules)


def test_cells_know_their_family_and_controls_have_none():
    names = ["noise_2mm", "scale_1.5", "scale_0.5", "clean", "removal_3mm_unverified", "bias_1mm"]
    assert [Cell.parse(n).family for n in names] == ["noise", "scale", None, None, None, None]
    assert [Cell.parse(n).name for n in names] == names
    assert not Cell.parse("clean_unverified").verified


def test_a_figure_shows_one_method_of_each_kind_and_scaled_ones_only_for_want_of_others():
    methods = ["dexflex@0.7", "dexflex", "dexflex-notouch", "dexgen@0.4", "raw", "shrink:0.5", "shrink:0.7"]
    assert main_methods(methods) == ["dexflex", "dexgen@0.4", "raw", "shrink:0.5"]
