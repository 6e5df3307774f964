from typing import Any

import pytest

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.oracle import FEW
from lerobot_dexflex.evaluation.reach.plots import main_methods
from lerobot_dexflex.interfaces import Method
from lerobot_dexflex.runs.provenance import imported


def test_the_clean_operator_is_a_method_like_others():
    method = Method.parse("clean")
    assert method.make().name == "clean"
    assert not method.learned
    assert "lerobot_dexflex.interfaces.raw" in imported(method.modules)


def test_the_oracle_takes_its_reference_first_and_settings_of_selection(controller_folder):
    method = Method.parse("oracle:moving=2+clean")
    assert method.name == "oracle:clean+moving=2"
    assert method.options == (("reference", "clean"), ("moving", 2))
    oracle: Any = method.make(controller_folder)
    assert (oracle._reference, oracle._moving, oracle.settings) == ("clean", 2, FEW)
    wide: Any = Method.parse("oracle:n_pure=3").make(controller_folder)
    assert wide.settings == SelectionSettings(n_pure=3)
    with pytest.raises(DexFlexError, match=r"`reference` must be 'draft' or 'clean'\. Got 'luck'"):
        Method.parse("oracle:luck").make(controller_folder)


def test_the_oracles_version_follows_its_own_module_too():
    modules = imported(Method.parse("oracle").modules)
    assert {"lerobot_dexflex.evaluation.reach.oracle", "lerobot_dexflex.interfaces.learned"} <= set(modules)


def test_a_figure_shows_one_method_of_each_kind_and_scaled_ones_only_for_want_of_others():
    methods = ["dexflex@0.7", "dexflex", "dexflex-notouch", "dexgen@0.4", "raw", "shrink:0.5", "shrink:0.7"]
    assert main_methods(methods) == ["dexflex", "dexgen@0.4", "raw", "shrink:0.5"]
