"""Names of datasets on the Hub: checked before any work, offline."""

from huggingface_hub.errors import HFValidationError
from huggingface_hub.utils import validate_repo_id

from lerobot_dexflex.errors import DexFlexError


def check_repo_id(repo_id: str) -> None:
    """Check the name of a dataset as the Hub does; it is also the name of a folder of a dry run.

    Raises:
        DexFlexError: If the Hub allows no such dataset.
    """
    remedy = "Choose --repo_id=<user>/<dataset>; nothing was changed."
    if repo_id.count("/") != 1:
        raise DexFlexError(f"`repo_id` must look like 'user/dataset'. Got {repo_id!r}. {remedy}")
    try:
        for name in (repo_id, *repo_id.split("/")):  # The Hub's validator looks at the end of the whole only.
            validate_repo_id(name)
    except HFValidationError as error:
        raise DexFlexError(f"The Hub allows no dataset {repo_id!r}: {error} {remedy}") from error
