import json

import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.upload import build_upload

NAME = "lerobot-dexflex/count"


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_an_upload_is_the_dataset_byte_for_byte(recorded, tmp_path):
    upload = build_upload(recorded, NAME, tmp_path / "upload")
    assert files_in(upload.folder) == files_in(recorded) == sorted(file.as_posix() for file in upload.files)
    assert all((upload.folder / file).read_bytes() == (recorded / file).read_bytes() for file in upload.files)
    assert upload.tag == "v3.0"
    assert {"README.md", "recipe.yaml", "meta/recording.json"} < set(files_in(upload.folder))


def test_leftovers_hidden_files_and_caches_stay_at_home(recorded, tmp_path):
    own = files_in(recorded)
    leftovers = (".cache/x", ".DS_Store", "notes.txt", "data/chunk-000/file-001.parquet", "images/0.png")
    for name in (*leftovers, "videos/observation.images.front/chunk-000/file-007.mp4"):
        (recorded / name).parent.mkdir(exist_ok=True)
        (recorded / name).write_bytes(b"left over")
    assert files_in(build_upload(recorded, NAME, tmp_path / "upload").folder) == own


def test_under_another_name_the_card_and_the_recipe_say_that_name(recorded, tmp_path):
    upload = build_upload(recorded, "ada/count-2", tmp_path / "upload")
    card, recipe = ((upload.folder / name).read_text() for name in ("README.md", "recipe.yaml"))
    assert "# ada/count-2\n" in card
    assert "repo_id: ada/count-2\n" in recipe
    assert NAME not in card + recipe
    assert "https://github.com/lerobot-dexflex/lerobot_dexflex" in card
    assert json.loads((upload.folder / "meta/recording.json").read_text())["recipe"]["repo_id"] == NAME


def test_an_unfinished_recording_is_refused_with_the_remedy(recorded, tmp_path):
    record = json.loads((recorded / "meta/recording.json").read_text())
    (recorded / "meta/recording.json").write_text(json.dumps(record | {"complete": False, "episodes": 1}))
    with pytest.raises(DexFlexError, match=r"unfinished \(1 of 2 episodes\).*Finish it with the command"):
        build_upload(recorded, NAME, tmp_path / "upload")
    assert not (tmp_path / "upload").exists()


@pytest.mark.parametrize("name", ["README.md", "videos/observation.images.wrist/chunk-000/file-000.mp4"])
def test_a_dataset_that_lost_a_file_is_refused_and_told_which(recorded, tmp_path, name):
    (recorded / name).unlink()
    with pytest.raises(DexFlexError, match=f"lacks {name}"):
        build_upload(recorded, NAME, tmp_path / "upload")
    assert not (tmp_path / "upload").exists()


def test_a_dataset_whose_index_and_description_disagree_is_refused(recorded, tmp_path):
    info = json.loads((recorded / "meta/info.json").read_text())
    (recorded / "meta/info.json").write_text(json.dumps(info | {"total_episodes": 7}))
    with pytest.raises(DexFlexError, match=r"2 episodes are indexed, meta/info.json counts 7"):
        build_upload(recorded, NAME, tmp_path / "upload")


def test_a_folder_that_is_no_recording_is_refused(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros(1))
    with pytest.raises(DexFlexError, match=r"no readable meta/recording.json"):
        build_upload(tmp_path, NAME, tmp_path / "upload")


def test_a_folder_in_use_is_never_written_to(recorded, tmp_path):
    (tmp_path / "upload").mkdir()
    (tmp_path / "upload/mine.txt").write_text("mine")
    with pytest.raises(DexFlexError, match="Choose another folder, or delete it"):
        build_upload(recorded, NAME, tmp_path / "upload")
    assert files_in(tmp_path / "upload") == ["mine.txt"]
