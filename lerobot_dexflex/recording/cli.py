"""The console script `dexflex-record`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.push import dry_run, push, require_login
from lerobot_dexflex.recording.record import record


def main(arguments: list[str] | None = None) -> int:
    """Record demonstrations and push them if told to; return 0 if done, 1 after an error, 130 if interrupted.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """
    return console.run(RecordConfig, _work, arguments)


def _work(config: RecordConfig, words: list[str]) -> int:
    uploads = config.push and config.push_dry_run is None
    if uploads:
        require_login()
    if not record(config, words):
        return 130
    if config.push_dry_run is not None:
        dry_run(config.root, config.repo_id, config.push_dry_run)
    elif uploads:
        push(config.root, config.repo_id)
    return 0


if __name__ == "__main__":
    sys.exit(main())
