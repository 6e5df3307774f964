"""The layout's promises: nothing shadows a dependency, plugins are found, only fit files are committed."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import draccus
import lerobot.policies  # noqa: F401  Registers LeRobot's own, such as ACT.
import pytest
import yaml
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.training.train import TrainConfig

ROOT = Path(__file__).parents[1]
DATA_FOLDERS = ("datasets", "configs", "eval", "policies", "tests")
BINARY_SUFFIXES = {".safetensors", ".parquet", ".mp4", ".png", ".arrow"}
MEGABYTE = 2**20


OURS = ("lerobot_dexflex", "lerobot_policy_dexflex")
FLOORS = (
    {"errors", "conventions", "console", "compiled", "_gl"},
    {"runs"},
    {"hands"},
    {"hand"},
    {"streams"},
    {"envs"},
    {"experts"},
    {"controller"},
    {"interfaces"},
    {"commands"},
    {"corpus", "recording"},
    {"training"},
    {"evaluation"},
    {"hand_check", "teleop"},
    {"lerobot_policy_dexflex"},
)
"""A package imports from floors below its own, never from above or beside."""


def run_python(*arguments: str, cwd: Path = ROOT) -> str:
    """Run a fresh interpreter and return what it prints."""
    result = subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


@pytest.fixture(scope="module")
def tracked_files() -> list[Path]:
    """Files that git tracks; skips outside a git checkout (an unpacked sdist)."""
    result = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if result.returncode:
        pytest.skip("not a git checkout")
    return [path for name in result.stdout.split("\0") if name and (path := ROOT / name).is_file()]


@pytest.mark.parametrize("folder", DATA_FOLDERS)
def test_data_folders_are_no_packages(folder):
    assert not (ROOT / folder / "__init__.py").exists()


def test_datasets_is_hugging_faces_when_imported_from_the_root():
    code = "import datasets; from datasets import Dataset; print(datasets.__file__)"
    assert Path(run_python("-c", code)).parent.parent.name == "site-packages"


def test_importing_the_library_loads_neither_mujoco_nor_lerobot():
    code = "import sys, lerobot_dexflex; print(*sorted({'mujoco', 'lerobot'} & set(sys.modules)))"
    assert run_python("-c", code) == ""


def test_importing_operator_streams_loads_neither_mujoco_nor_lerobot():
    modules = [path.stem for path in (ROOT / "lerobot_dexflex/streams").glob("[!_]*.py")]
    assert {"rokoko", "retarget"} <= set(modules)
    imports = "".join(f"import lerobot_dexflex.streams.{name};" for name in modules)
    code = f"import sys; {imports} print(*sorted({{'mujoco', 'lerobot'}} & set(sys.modules)))"
    assert run_python("-c", code) == ""


def test_importing_the_plugin_loads_neither_models_nor_mujoco():
    code = (
        "import sys, lerobot_policy_dexflex;"
        "print(*[m for m in sys.modules if m == 'mujoco' or m.startswith('lerobot_policy_dexflex.model')])"
    )
    assert run_python("-c", code) == ""


def test_lerobot_discovers_policy_environment_processor_step_and_teleoperator():
    code = (
        "from lerobot.utils.import_utils import register_third_party_plugins as register;"
        "from lerobot.configs import PreTrainedConfig; from lerobot.envs import EnvConfig; register();"
        "from lerobot.processor import ProcessorStepRegistry;"
        "from lerobot.teleoperators import TeleoperatorConfig;"
        "print('dexflex_flow' in PreTrainedConfig.get_known_choices(),"
        " 'dexflex' in EnvConfig.get_known_choices(),"
        " 'dexflex_interface_processor' in ProcessorStepRegistry.list(),"
        " 'dexflex_glove' in TeleoperatorConfig.get_known_choices())"
    )
    assert run_python("-c", code) == "True True True True"


@pytest.mark.parametrize("options", [["-m"], ["-P", "-m"]], ids=["root on path", "root off path"])
def test_tests_are_collected_with_and_without_the_root_on_the_path(options):
    printed = run_python(*options, "pytest", "--collect-only", "-q", "tests/test_layout.py")
    assert "test_data_folders_are_no_packages" in printed


def test_distribution_is_named_so_that_lerobot_finds_it():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["name"] == "lerobot_policy_dexflex"
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["packages"] == ["lerobot_dexflex", "policies/lerobot_policy_dexflex"]


def test_every_config_and_recipe_is_parsed_by_its_dataclass():
    register_third_party_plugins()
    kinds = {"policy": TrainPipelineConfig, "controller": TrainConfig, "corpus": CorpusConfig}
    parsed = set()
    for folder, kind in kinds.items():
        for path in (ROOT / "configs" / folder).glob("*.yaml"):
            assert isinstance(draccus.parse(kind, path, args=[]), kind)
            parsed.add(path)
    for path in (ROOT / "datasets").rglob("recipe.yaml"):
        recipe = yaml.safe_load(path.read_text())
        kind = CorpusConfig if "recipe" in recipe else RecordConfig
        assert isinstance(draccus.decode(kind, recipe.get("recipe", recipe)), kind)
        parsed.add(path)
    assert parsed == {*ROOT.glob("configs/**/*.yaml"), *ROOT.glob("datasets/**/*.yaml")} != set()


def test_no_tracked_file_is_a_pickle_or_an_unexpected_binary(tracked_files):
    binaries = [path for path in tracked_files if b"\0" in path.read_bytes()[:4096]]
    assert [path for path in binaries if path.suffix not in BINARY_SUFFIXES] == []


def test_no_tracked_file_exceeds_ten_megabytes(tracked_files):
    assert [path for path in tracked_files if path.stat().st_size > 10 * MEGABYTE] == []


def test_every_checkpoint_is_at_most_eight_megabytes(tracked_files):
    weights = [path for path in tracked_files if path.suffix == ".safetensors"]
    assert [path for path in weights if path.stat().st_size > 8 * MEGABYTE] == []


def test_shipped_dataset_is_at_most_ten_megabytes(tracked_files):
    for dataset in (ROOT / "datasets").iterdir():
        size = sum(path.stat().st_size for path in tracked_files if path.is_relative_to(dataset))
        assert size <= 10 * MEGABYTE, dataset


def test_every_module_stays_below_the_house_limit(tracked_files):
    modules = [path for path in tracked_files if path.suffix == ".py"]
    too_long = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in modules}
    assert {name: lines for name, lines in too_long.items() if lines >= 400} == {}


def imports_between_packages() -> dict[tuple[str, str], set[str]]:
    """Return which package imports which, and the modules that do, from the source."""
    found: dict[tuple[str, str], set[str]] = {}
    for folder in (ROOT / "lerobot_dexflex", ROOT / "policies/lerobot_policy_dexflex"):
        for file in folder.rglob("*.py"):
            parts = file.relative_to(folder).with_suffix("").parts
            here = parts[0] if folder.name == "lerobot_dexflex" else folder.name
            for node in ast.walk(ast.parse(file.read_text())):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.module:
                    names = [node.module]
                for name in names:
                    top, _, rest = name.partition(".")
                    there = rest.partition(".")[0] if top == "lerobot_dexflex" else top
                    if top in ("lerobot_dexflex", "lerobot_policy_dexflex") and there not in ("", here):
                        found.setdefault((here, there), set()).add("/".join(parts))
    return found


def test_no_package_imports_one_above_or_beside_it():
    floor = {name: k for k, names in enumerate(FLOORS) for name in names}
    library = {path.stem for path in (ROOT / "lerobot_dexflex").iterdir() if not path.name.startswith("__")}
    assert {*library, "lerobot_policy_dexflex"} == set(floor)
    wrong = {
        f"{here} -> {there}": sorted(files)
        for (here, there), files in imports_between_packages().items()
        if here != "__init__" and floor[there] >= floor[here] and floor[here] > 0
    }
    assert wrong == {}


def test_every_package_that_is_imported_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {
        re.split(r"[\[<>=~! ]", each)[0].replace("-", "_").lower() for each in project["dependencies"]
    }
    # rerun-sdk puts its package into a folder of its own, where it is not found.
    provided = {**packages_distributions(), "rerun": ["rerun-sdk"]}
    ours = {*OURS, *(script.stem for script in (ROOT / "eval").glob("*.py"))}
    missing = {}
    for folder in ("lerobot_dexflex", "policies", "eval", "docs"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    names = [node.module]
                for top in {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names):
                    distributions = {each.replace("-", "_").lower() for each in provided.get(top, [top])}
                    if top not in ours and not distributions & declared:
                        missing.setdefault(top, str(file.relative_to(ROOT)))
    assert missing == {}
