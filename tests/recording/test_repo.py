import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.cli import main
from lerobot_dexflex.recording.repo import check_repo_id
from lerobot_dexflex.recording.upload import build_upload

FORBIDDEN = (
    "../evil",
    "me/../evil",
    "me/..",
    "/evil",
    "me/",
    "count",
    "a/b/c",
    "me/data set",
    "me/x--y",
    "m--e/x",
    "me/x..y",
    "me/x.git",
    "me.git/x",
    "me/.x",
    "me/x-",
    "me/naïve",
    f"me/{97 * 'x'}",
    f"{97 * 'x'}/me",
)


@pytest.mark.parametrize("name", ["ada/count", "Ada-1/data.set_2-x", f"me/{96 * 'x'}"])
def test_names_that_the_hub_allows_pass(name):
    check_repo_id(name)


@pytest.mark.parametrize("name", FORBIDDEN)
def test_names_that_the_hub_forbids_are_refused_before_any_work(name, tmp_path, capsys):
    for way in (f"--push_dry_run={tmp_path / 'hub'}", "--push", "--workers=0"):
        assert main([f"--root={tmp_path / 'x'}", f"--repo_id={name}", way]) == 1
        error = capsys.readouterr().err
        assert name in error
        assert "Choose --repo_id=<user>/<dataset>" in error
    assert list(tmp_path.iterdir()) == []


def test_a_folder_whose_name_the_hub_forbids_needs_a_name_for_the_hub(tmp_path, capsys):
    assert main([f"--root={tmp_path / 'my data'}"]) == 1
    assert "no dataset 'lerobot-dexflex/my data'" in capsys.readouterr().err


def test_an_upload_under_a_forbidden_name_writes_nothing(recorded, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DexFlexError, match="allows no dataset"):
        build_upload(recorded, "../evil", tmp_path / "upload")
    assert sorted(tmp_path.rglob("*")) == before
