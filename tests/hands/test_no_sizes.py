"""Outside `hands/` no code knows a hand by name, its number of fingers, joints or taxels, or their names.

What is searched for is what sizes of the first hand looked like in code: 4 fingers, 16 joints, 23 with the
arm, 12 coordinates of fingertips, 240 taxels.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("lerobot_dexflex", "policies/lerobot_policy_dexflex")
SIZES = {4, 12, 16, 23, 240}
QUATERNION = 4
"""Alone it may be the length of a quaternion."""
SHAPING = {
    *("zeros", "ones", "empty", "full", "rand", "randn", "eye", "range", "permutation"),
    *("view", "reshape", "expand", "unflatten", "broadcast_to", "tile", "repeat_interleave", "Box", "split"),
}
"""Functions whose arguments are sizes."""
COUNTING = ("range", "permutation", "expand", "eye")
"""Of these, those that hardly ever meet a quaternion."""
HANDS = {"LEAP", "SHARPA", "FINGER_NAMES"}
FINGERS = re.compile(r"thumb|pinky|(if|mf|rf|th)_(tip|pad|nose|bs|px|md|ds|mp|taxels?|load)")
"""What fingers, links and sites are called; `index`, `middle` and `ring` have other meanings, too."""
SHAPES = re.compile(r"\((?:[\w ]+, )*(?:4, 3|12|16|23|240)(?:, [\w ]+)*,?\)")
"""In docstrings."""

OTHER = {
    "lerobot_dexflex/envs/driver_and_screw.py": ("range of 4",),
    "lerobot_dexflex/envs/leg_and_socket.py": ("range of 4",),
    "lerobot_dexflex/envs/nut_and_bolt.py": ("range of 12",),
    "lerobot_dexflex/hand/contacts.py": ("reshape of 4",),
    "lerobot_dexflex/runs/provenance.py": ("slice at 16",),
    "lerobot_dexflex/streams/record.py": ("calls a finger 'pinky'", "calls a finger 'thumb'"),
}
"""What looks like a hand and is none: sides of geoms, edges of cones, digits, fingers of people."""

NOT_YET = {
    "lerobot_dexflex/controller/chunks.py",
    "lerobot_dexflex/controller/config.py",
    "lerobot_dexflex/controller/controller.py",
    "lerobot_dexflex/controller/decoder.py",
    "lerobot_dexflex/controller/diffusion_prior.py",
    "lerobot_dexflex/controller/encoder.py",
    "lerobot_dexflex/controller/history.py",
    "lerobot_dexflex/controller/splitter.py",
    "lerobot_dexflex/conventions.py",
    "lerobot_dexflex/corpus/acquisition.py",
    "lerobot_dexflex/corpus/distortion.py",
    "lerobot_dexflex/corpus/env.py",
    "lerobot_dexflex/corpus/episode.py",
    "lerobot_dexflex/corpus/turning.py",
    "lerobot_dexflex/corpus/world.py",
    "lerobot_dexflex/interfaces/dexflex.py",
    "lerobot_dexflex/interfaces/explanation.py",
    "lerobot_dexflex/interfaces/learned.py",
    "lerobot_dexflex/training/augmentation.py",
    "lerobot_dexflex/training/bank.py",
    "lerobot_dexflex/training/corpus_data.py",
    "lerobot_dexflex/training/encoder_prior.py",
    "lerobot_dexflex/training/splitter.py",
    "lerobot_dexflex/training/world_model.py",
}
"""Files that are still to be freed of sizes; who does it takes them off."""


def sources() -> list[str]:
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return sorted(str(p.relative_to(ROOT)) for p in paths if "hands" not in p.relative_to(ROOT).parts)


def findings(text: str) -> list[str]:
    """Return what of a module's source is of one hand, as `line: what`."""
    tree = ast.parse(text)
    documents = {id(node) for each in ast.walk(tree) if (node := _docstring(each)) is not None}
    found = []
    for node in ast.walk(tree):
        found += [(getattr(node, "lineno", 0), what) for what in _of_one_hand(node, id(node) in documents)]
    return [f"{line}: {what}" for line, what in sorted(set(found))]


def _docstring(node: ast.AST) -> ast.expr | None:
    """Return the text of a statement that is nothing but text."""
    return node.value if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) else None


def _of_one_hand(node: ast.AST, document: bool) -> list[str]:
    match node:
        case ast.ImportFrom(names=names):
            return [f"imports {alias.name}" for alias in names if alias.name in HANDS]
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=args, keywords=keywords):
            given = [k.value for k in keywords if k.arg == "shape"] + (args if name in SHAPING else [])
            several = len(args) > 1 or name in COUNTING
            return [f"{name} of {size}" for each in given for size in _sizes(each, several)]
        case ast.Slice(lower=lower, upper=upper):
            bounds = [abs(_number(bound) or 0) for bound in (lower, upper) if bound is not None]
            return [f"slice at {size}" for size in bounds if size in SIZES - {QUATERNION}]
        case ast.Compare(left=ast.Call(func=ast.Name(id="len")), comparators=[right]):
            return [f"len compared with {_number(right)}"] if _number(right) in SIZES - {QUATERNION} else []
        case ast.Constant(value=str() as text) if document:
            return [f"docstring has {shape}" for shape in SHAPES.findall(text)]
        case ast.Constant(value=str() as text):
            return [f"calls a finger {text!r}"] if FINGERS.fullmatch(text) else []
    return []


def _sizes(node: ast.expr, several: bool) -> list[int]:
    """Return sizes in an argument; a quaternion's length counts if it stands among others."""
    if isinstance(node, ast.Tuple | ast.List):
        return [size for element in node.elts if (size := _number(element)) in SIZES]
    size = _number(node)
    return [size] if size in (SIZES if several else SIZES - {QUATERNION}) else []


def _number(node: ast.expr) -> int | None:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return _number(node.operand)
    return node.value if isinstance(node, ast.Constant) and type(node.value) is int else None


@pytest.mark.parametrize("source", sources())
def test_no_file_is_of_one_hand(source):
    found = [line for line in findings((ROOT / source).read_text()) if not _is_other(source, line)]
    if source in NOT_YET:
        assert found, f"{source} is free of sizes: take it off NOT_YET."
    else:
        assert found == [], f"{source} is of one hand; take sizes and names from a `Hand` that is passed in."


def test_lists_name_files_that_there_are():
    assert {*NOT_YET, *OTHER} <= {*sources()}


@pytest.mark.parametrize(
    ("code", "what"),
    [
        ("from lerobot_dexflex.hands import LEAP, Hand", "imports LEAP"),
        ("x = np.zeros((n, 4, 3))", "zeros of 4"),
        ("x = tips.view(-1, 4, 3)", "view of 4"),
        ("for finger in range(4): pass", "range of 4"),
        ("joints = state[:, -16:]", "slice at 16"),
        ("pose = qpos[16:23]", "slice at 23"),
        ("arm = len(joints) > 16", "len compared with 16"),
        ("space = Box(0, inf, (240,), float)", "Box of 240"),
        ("thumb = names.index('thumb')", "calls a finger 'thumb'"),
        ("tip = model.site('th_tip')", "calls a finger 'th_tip'"),
        ("def f():\n    'Shape (batch, 4, 3).'", "docstring has (batch, 4, 3)"),
    ],
)
def test_what_is_of_one_hand_is_found(code, what):
    assert any(line.endswith(f": {what}") for line in findings(code))


@pytest.mark.parametrize(
    "code",
    [
        "from lerobot_dexflex.hands import Hand, get_hand",
        "quaternion, vector = np.zeros(4), np.zeros(3)",
        "x = np.zeros((n, hand.n_fingers, 3))",
        "x = quaternions[:, :4]",
        "size = 16 * kilobyte",
        "frame.index('index')",
    ],
)
def test_what_is_of_any_hand_passes(code):
    assert findings(code) == []


def _is_other(source: str, line: str) -> bool:
    return any(line.endswith(f": {what}") for what in OTHER.get(source, ()))
