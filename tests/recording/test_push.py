"""Pushing to a Hub that is only a list of calls."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import yaml
from huggingface_hub.errors import LocalTokenNotFoundError, OfflineModeIsEnabled, RevisionNotFoundError

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording import push as push_module
from lerobot_dexflex.recording.cli import main
from lerobot_dexflex.recording.push import dry_run, push
from lerobot_dexflex.recording.upload import build_upload

NAME = "lerobot-dexflex/count"
COMMIT = "0123456789abcdef0123456789abcdef01234567"


class Hub:
    """Stands in for `HfApi`: remembers what was asked of it, and fails where told to."""

    def __init__(self):
        self.calls: list[tuple[str, dict]] = []
        self.uploaded: dict[str, bytes] = {}
        self.failures: dict[str, Exception] = {}

    def __getattr__(self, method):
        def call(repo_id, **arguments):
            self.calls.append((method, {"repo_id": repo_id, **arguments}))
            if method in self.failures:
                raise self.failures[method]
            if method == "upload_folder":
                folder = Path(arguments["folder_path"])
                found = [path for path in folder.rglob("*") if path.is_file()]
                self.uploaded = {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}
                return SimpleNamespace(oid=COMMIT)
            return None

        return call


@pytest.fixture
def hub(monkeypatch):
    hub = Hub()
    monkeypatch.setattr(push_module, "HfApi", lambda: hub)
    monkeypatch.setattr(push_module, "get_token", lambda: "hf_token")
    return hub


def words(task, root, *more):
    return [f"--task={task}", "--episodes=2", "--workers=0", f"--root={root}", *more]


def test_pushing_makes_the_repository_uploads_in_one_commit_and_tags_it(recorded, hub, capsys):
    push(recorded, NAME)
    assert [method for method, _ in hub.calls] == ["create_repo", "upload_folder", "delete_tag", "create_tag"]
    assert all(call["repo_id"] == NAME and call["repo_type"] == "dataset" for _, call in hub.calls)
    assert hub.calls[0][1]["exist_ok"]
    assert hub.calls[1][1]["delete_patterns"] == ["data/*", "meta/*", "videos/*"]
    assert (hub.calls[3][1]["tag"], hub.calls[3][1]["revision"]) == ("v3.0", COMMIT)
    output = capsys.readouterr().out
    assert f"https://huggingface.co/datasets/{NAME}, commit {COMMIT}" in output
    assert "revision tag v3.0" in output


def test_a_dry_run_builds_exactly_what_pushing_uploads(recorded, hub, tmp_path, capsys):
    (recorded / ".hidden").write_text("left over")
    dry_run(recorded, NAME, tmp_path / "hub")
    listed = capsys.readouterr().out
    assert hub.calls == []
    push(recorded, NAME)
    built = tmp_path / "hub" / NAME
    assert hub.uploaded == {
        path.relative_to(built).as_posix(): path.read_bytes() for path in built.rglob("*") if path.is_file()
    }
    assert all(f"{len(content):>13,}  {name}\n" in listed for name, content in hub.uploaded.items())
    assert f"{sum(map(len, hub.uploaded.values())):>13,}  bytes in 10 files, revision tag v3.0" in listed


def test_the_first_push_finds_no_tag_to_move(recorded, hub):
    response = httpx.Response(404, request=httpx.Request("DELETE", "https://huggingface.co"))
    hub.failures["delete_tag"] = RevisionNotFoundError("no such revision", response=response)
    push(recorded, NAME)
    assert hub.calls[-1][0] == "create_tag"


@pytest.mark.parametrize(
    "failure",
    [
        OfflineModeIsEnabled("offline mode is enabled"),
        LocalTokenNotFoundError("Token is required"),
        httpx.ConnectError("Name or service not known"),
    ],
)
def test_what_the_network_refuses_is_one_error_with_the_remedy(recorded, hub, failure):
    before = sorted(recorded.rglob("*"))
    hub.failures["create_repo"] = failure
    with pytest.raises(DexFlexError, match=r"Nothing is lost(.|\n)*hf auth login") as caught:
        push(recorded, NAME)
    assert str(failure) in str(caught.value)
    assert sorted(recorded.rglob("*")) == before


def test_a_name_that_the_hub_forbids_is_one_error(recorded, monkeypatch):
    monkeypatch.setattr(push_module, "get_token", lambda: "hf_token")
    with pytest.raises(DexFlexError, match="allows no dataset 'my org/count'"):
        push(recorded, "my org/count")


def test_without_a_token_nothing_is_recorded_first(counting_task, hub, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(push_module, "get_token", lambda: None)
    assert main(words(counting_task, tmp_path / "count", "--push")) == 1
    assert "hf auth login" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == hub.calls == []


def test_the_flag_push_records_then_uploads_and_later_only_uploads(counting_task, hub, tmp_path, capsys):
    root = tmp_path / "count"
    assert main(words(counting_task, root, "--push")) == 0
    first = hub.uploaded
    assert main([f"--config_path={root / 'recipe.yaml'}", "--push", "--repo_id=ada/count"]) == 0
    assert "Nothing to record" in capsys.readouterr().out
    assert hub.calls[-1][1]["repo_id"] == "ada/count"
    assert hub.uploaded.keys() == first.keys()


def test_pushing_is_no_part_of_the_recipe(counting_task, hub, tmp_path):
    root = tmp_path / "count"
    assert main(words(counting_task, root, "--push=true", f"--push_dry_run={tmp_path / 'hub'}")) == 0
    assert hub.calls == [], "a dry run uploaded"
    assert (tmp_path / "hub/lerobot-dexflex/count/meta/info.json").is_file()
    recipe = yaml.safe_load((root / "recipe.yaml").read_text())
    assert recipe == json.loads((root / "meta/recording.json").read_text())["recipe"]
    assert not {"push", "push_dry_run"} & recipe.keys()
    assert main(words(counting_task, root)) == 0, "the same recipe without pushing is another one"


def downloaded(root, name, cache):
    """Leave what a download of the uploaded dataset leaves in a cache of the Hub; return its snapshot."""
    repository = cache / f"datasets--{name.replace('/', '--')}"
    upload = build_upload(root, name, repository / "snapshots" / COMMIT)
    sizes = {file.as_posix(): (upload.folder / file).stat().st_size for file in upload.files}
    listing = {name: {"size": size, "blob_id": "0" * 40} for name, size in sizes.items()}
    (repository / "refs").mkdir()
    (repository / "refs/main").write_text(COMMIT)
    (repository / "trees").mkdir()
    (repository / f"trees/{COMMIT}.json").write_text(json.dumps({"format_version": 1, "files": listing}))
    return upload.folder


@pytest.fixture
def load(tmp_path, monkeypatch):
    """LeRobot's way from a name to data, without network and with `tmp_path` as HF_LEROBOT_HOME.

    LeRobot reads the environment when it is imported; README's command proves that variable itself.
    """
    from lerobot.datasets import dataset_metadata, lerobot_dataset

    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.setattr(dataset_metadata, "HF_LEROBOT_HOME", tmp_path)
    for module in (dataset_metadata, lerobot_dataset):
        monkeypatch.setattr(module, "HF_LEROBOT_HUB_CACHE", tmp_path / "hub")

    def load(name, **options):
        dataset = lerobot_dataset.LeRobotDataset(name, video_backend="pyav", **options)
        assert (dataset.num_episodes, len(dataset)) == (2, 18)
        frame: Any = dataset[17]
        assert frame["observation.images.front"].shape == (3, 96, 96)
        return dataset.root

    return load


@pytest.mark.parametrize("revision", [None, "v3.0", COMMIT])
def test_lerobot_finds_a_dry_run_by_its_name_offline(recorded, load, tmp_path, revision):
    dry_run(recorded, NAME, tmp_path)
    assert load(NAME, revision=revision) == tmp_path / NAME


@pytest.mark.parametrize("revision", ["main", COMMIT])
def test_lerobot_finds_a_downloaded_upload_by_its_name_and_pinned_revision_offline(
    recorded, load, tmp_path, revision
):
    snapshot = downloaded(recorded, NAME, tmp_path / "hub")
    assert load(NAME, revision=revision) == snapshot


def test_lerobot_loads_an_upload_from_a_root_with_a_pinned_revision_offline(recorded, load, tmp_path):
    upload = build_upload(recorded, NAME, tmp_path / "elsewhere")
    assert load(NAME, root=upload.folder, revision="v3.0") == upload.folder
