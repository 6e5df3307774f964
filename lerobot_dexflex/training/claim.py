"""What decides the weights in a stage's folder, kept beside them: other settings are refused by name."""

import json
from pathlib import Path
from typing import Any

from lerobot_dexflex.errors import DexFlexError

SETTINGS = "settings.json"


def claim(folder: Path, settings: dict[str, Any]) -> None:
    """Make a folder that of these settings, or continue it if it is.

    Args:
        folder: Of one stage; created if missing.
        settings: Plain values, nested or not, on which its weights depend.

    Raises:
        DexFlexError: If the folder holds anything made with other settings; names each of them.
    """
    wanted: dict[str, Any] = json.loads(json.dumps(flat(settings)))
    path = folder / SETTINGS
    if path.is_file():
        found = _read(path)
        differences = [
            f"  {name}: {found.get(name)!r} there, {wanted.get(name)!r} now"
            for name in dict.fromkeys((*wanted, *found))
            if found.get(name) != wanted.get(name)
        ]
        if differences:
            raise DexFlexError(
                f"{folder} was trained with other settings:\n" + "\n".join(differences) + "\nRestore them to "
                "go on, choose another --output, or delete that folder to train it anew; nothing was changed."
            )
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise DexFlexError(
            f"{folder} holds files, but no {SETTINGS} that says how they were made. Choose another --output, "
            "or delete that folder to train it anew; nothing was changed."
        )
    folder.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(wanted, indent=2) + "\n")
    temporary.replace(path)


def flat(settings: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Return nested settings with dotted names."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= flat(value, f"{path}{name}.") if isinstance(value, dict) else {path + name: value}
    return found


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text())
        if isinstance(found, dict):
            return found
    except ValueError:
        pass
    raise DexFlexError(f"{path} is damaged. Delete its folder to train that stage anew; nothing was changed.")
