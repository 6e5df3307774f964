"""Versions: every byte that is imported counts, and nothing else of the project."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_dexflex.runs import provenance
from lerobot_dexflex.runs.provenance import code_digest, imported, method_version, weights_digest

RAW = "lerobot_dexflex.interfaces.raw"


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """The library's source, copied, so that files may be changed."""
    root = tmp_path / "lerobot_dexflex"
    shutil.copytree(provenance.PACKAGE, root, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "PACKAGE", root)
    provenance._root.cache_clear()
    yield root
    provenance._root.cache_clear()


def file_of(root: Path, module: str) -> Path:
    path = root.joinpath(*module.split(".")[1:])
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def test_a_changed_byte_in_any_imported_module_changes_the_version(copied):
    before = method_version([RAW]).name
    modules = [name for name in imported([RAW]) if name.startswith("lerobot_dexflex")]
    assert {RAW, "lerobot_dexflex.hand.kinematics", "lerobot_dexflex.errors"} <= set(modules)
    for module in modules:
        file = file_of(copied, module)
        content = file.read_bytes()
        file.write_bytes(content + b"\n")
        assert method_version([RAW]).name != before, module
        file.write_bytes(content)
    assert method_version([RAW]).name == before


def test_a_module_that_is_not_imported_does_not_change_the_version(copied):
    before = code_digest([RAW])
    file = file_of(copied, "lerobot_dexflex.envs.pour_cup")
    file.write_bytes(file.read_bytes() + b"\n")
    assert "lerobot_dexflex.envs.pour_cup" not in imported([RAW])
    assert code_digest([RAW]) == before


def test_what_importing_really_loads_is_among_what_was_read_from_the_source():
    code = f"import sys, {RAW}; print(*[m for m in sys.modules if m.startswith('lerobot_dexflex')])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    unseen = set(loaded.stdout.split()) - set(imported([RAW]))
    assert unseen <= {
        "lerobot_dexflex.interfaces.entries"
    }  # The list of all interfaces decides none of them.


def test_options_and_weights_change_the_version(tmp_path):
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    (tmp_path / "README.md").write_text("card")
    first = method_version([RAW], [tmp_path], gain=0.4)
    assert first.name == method_version([RAW], [tmp_path], gain=0.4).name
    assert first.name != method_version([RAW], [tmp_path], gain=0.5).name
    (tmp_path / "README.md").write_text("another card")
    assert weights_digest([tmp_path]) == first.weights
    (tmp_path / "model.safetensors").write_bytes(b"others")
    assert weights_digest([tmp_path]) != first.weights


def test_a_module_that_does_not_exist_is_refused():
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        code_digest(["lerobot_dexflex.no_such_module"])
