import json

import numpy as np
import pyarrow.parquet as pq

from lerobot_dexflex.recording.moments import STATS_FILE, write_exact_moments


def test_moments_are_exact_and_a_constant_column_has_no_deviation(recorded):
    before = json.loads((recorded / STATS_FILE).read_text())
    stats = json.loads((recorded / STATS_FILE).read_text())
    stats["observation.gravity"]["std"] = [1e-4] * 3  # As float32 sums leave it.
    stats["action"]["mean"] = [5.0] * 35
    (recorded / STATS_FILE).write_text(json.dumps(stats))
    write_exact_moments(recorded)
    after = json.loads((recorded / STATS_FILE).read_text())
    assert after == before  # What recording left was exact already.
    assert after["observation.gravity"]["std"] == [0, 0, 0]
    assert after["observation.gravity"]["mean"] == [0, 0, -1]
    (file,) = recorded.glob("data/*/*.parquet")
    actions = np.stack(pq.read_table(file)["action"].to_numpy()).astype(np.float64)
    np.testing.assert_allclose(after["action"]["std"], actions.std(0), rtol=0, atol=1e-15)
    assert after["observation.images.front"] == stats["observation.images.front"]
