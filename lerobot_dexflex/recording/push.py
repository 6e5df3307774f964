"""`--push`: a finished recording goes to the Hub, or first to a folder to look at."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx
from huggingface_hub import HfApi, get_token
from huggingface_hub.errors import RevisionNotFoundError

from lerobot_dexflex.console import INTERRUPTED
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.recipe import Recipe
from lerobot_dexflex.recording.repo import check_repo_id
from lerobot_dexflex.recording.upload import Upload, build_upload


def then_push(config: Recipe, work: Callable[[], bool]) -> int:
    """Record, then push if told to; without a login it does not begin.

    Args:
        config: The recipe.
        work: Records; returns False after an interrupt.

    Returns:
        Status of the console script.
    """
    uploads = config.push and config.push_dry_run is None
    if uploads:
        require_login()
    if not work():
        return INTERRUPTED
    if config.push_dry_run is not None:
        dry_run(config.root, config.repo_id, config.push_dry_run)
    elif uploads:
        push(config.root, config.repo_id)
    return 0


def require_login() -> None:
    """Tell a user without a token so before hours of recording, not after.

    Raises:
        DexFlexError: If this machine holds no Hub token.
    """
    if get_token() is None:
        raise DexFlexError(
            "`--push` needs a Hub token with write access, and this machine has none. Run `hf auth login` "
            "(or set HF_TOKEN), then the same command again; or only look, offline: --push_dry_run=<folder>."
        )


def push(root: Path, repo_id: str) -> None:
    """Upload a finished recording as the dataset repository `repo_id` and tag its revision.

    `LeRobotDataset.push_to_hub` would upload whatever lies in the folder and replace our card by its own;
    commit and tag are otherwise as there. Files of an earlier upload that the dataset no longer has are
    deleted in the same commit, because LeRobot reads every parquet file that it finds.

    Args:
        root: Folder of the dataset.
        repo_id: Its name on the Hub.

    Raises:
        DexFlexError: If the Hub allows no such name, cannot be reached or refuses, or the recording is
            unfinished or damaged.
    """
    api = HfApi()
    with TemporaryDirectory() as temporary:
        upload = build_upload(root, repo_id, Path(temporary) / "upload")
        with _hub_errors(root, repo_id):
            api.create_repo(repo_id, repo_type="dataset", exist_ok=True)
            commit = api.upload_folder(
                repo_id=repo_id,
                folder_path=upload.folder,
                repo_type="dataset",
                commit_message="Upload by lerobot_dexflex",
                delete_patterns=["data/*", "meta/*", "videos/*"],
            )
            with contextlib.suppress(RevisionNotFoundError):
                api.delete_tag(repo_id, tag=upload.tag, repo_type="dataset")
            api.create_tag(repo_id, tag=upload.tag, revision=commit.oid, repo_type="dataset")
        print(_listing(upload))
    print(f"Pushed to https://huggingface.co/datasets/{repo_id}, commit {commit.oid}.")
    print(f"Pin exactly this with --dataset.repo_id={repo_id} --dataset.revision={commit.oid}")


def dry_run(root: Path, repo_id: str, home: Path) -> None:
    """Build in `home/repo_id` the files that `push` would upload, byte by byte, without network; list them.

    What only the Hub knows is not tried: the login, the right to write, files that are there already. `push`
    deletes those that lie in `data`, `meta` or `videos` and are not among these; the Hub adds its own
    `.gitattributes`.

    LeRobot looks for datasets by name in `HF_LEROBOT_HOME`, so with `home` there it loads this one.

    Args:
        root: Folder of the dataset.
        repo_id: Its name on the Hub.
        home: Folder of folders of datasets.

    Raises:
        DexFlexError: If the Hub allows no such name, the recording is unfinished or damaged, or
            `home/repo_id` holds anything or lies outside of `home`, behind a link.
    """
    check_repo_id(repo_id)
    folder = home / repo_id
    if folder.resolve() != home.resolve() / repo_id:
        raise DexFlexError(
            f"{folder} is {folder.resolve()}, behind a link, and a dry run writes only in its own folder. "
            "Choose another --push_dry_run; nothing was changed."
        )
    upload = build_upload(root, repo_id, folder)
    print(f"{upload.folder} is what --push would upload to https://huggingface.co/datasets/{repo_id}:")
    print(_listing(upload))
    print(f"Load it by its name, offline, with HF_LEROBOT_HOME={home} and --dataset.repo_id={repo_id}")


def _listing(upload: Upload) -> str:
    sizes = [(upload.folder / file).stat().st_size for file in upload.files]
    lines = [f"{size:>13,}  {file.as_posix()}" for size, file in zip(sizes, upload.files, strict=True)]
    total = f"{sum(sizes):>13,}  bytes in {len(sizes)} files, revision tag {upload.tag}"
    return "\n".join([*lines, total])


@contextlib.contextmanager
def _hub_errors(root: Path, repo_id: str) -> Iterator[None]:
    """Explain what the Hub or the network refused; what was recorded stays as it is."""
    try:
        yield
    except (httpx.HTTPError, OSError) as error:
        reason = str(error).strip() or type(error).__name__
        raise DexFlexError(
            f"Could not upload to {repo_id}: {reason}\nNothing is lost: {root} is complete. Check the "
            "network (HF_HUB_OFFLINE must not be set), the login (`hf auth login`, a token that may write) "
            f"and that {repo_id.split('/')[0]!r} is yours (else --repo_id=<you>/<dataset>); then run the "
            "same command again."
        ) from error
