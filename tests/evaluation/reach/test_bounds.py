from lerobot_dexflex.evaluation.reach.bounds import FORCES, OPERATOR
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import Method
from lerobot_dexflex.runs.provenance import imported


def test_bounds_are_methods_like_others():
    for name in (OPERATOR, FORCES):
        method = Method.parse(name)
        assert (method.make(LEAP).name, method.learned) == (name, False)
        assert "lerobot_dexflex.evaluation.reach.privileged" in imported(method.modules)
