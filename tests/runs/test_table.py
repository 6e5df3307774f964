"""Rows on disk: appended, typed, repaired after a kill, never silently another's."""

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.provenance import Version
from lerobot_dexflex.runs.table import Table


def row(seed, **values):
    key = {"method": "raw", "version": "12345678", "task": "T-v0", "condition": "clean", "seed": seed}
    return key | values


@pytest.fixture
def table(tmp_path):
    return Table(tmp_path / "episodes.csv", ["success", "drops", "holding"])


def test_rows_come_back_with_their_types_and_gaps(table):
    table.append([row(7, success=True, drops=None, holding=0.5), row(8, success=False, drops=None)])
    found = table.load()
    assert found["version"].tolist() == ["12345678"] * 2
    assert found["success"].tolist() == [True, False]
    assert found["seed"].tolist() == [7, 8]
    assert found["holding"].isna().tolist() == [False, True]
    assert found["drops"].isna().all()


def test_a_row_that_is_there_twice_counts_once_the_first(table):
    table.append([row(7, success=True)])
    table.append([row(7, success=False), row(8, success=False)])
    assert table.load()["success"].tolist() == [True, False]


def test_a_torn_line_is_left_out_and_cut_off_before_the_next_row(table):
    table.append([row(7, success=True)])
    with table.path.open("a") as file:
        file.write("raw,123")
    assert table.load()["seed"].tolist() == [7]
    again = Table(table.path, ["success", "drops", "holding"])
    again.append([row(8, success=False)])
    assert again.load()["seed"].tolist() == [7, 8]


def test_new_columns_are_added_to_an_older_table(table):
    table.append([row(7, success=True)])
    wider = Table(table.path, ["success", "force"])
    wider.append([row(8, success=False, force=1.5)])
    assert wider.load()["force"].isna().tolist() == [True, False]
    assert wider.load()["success"].tolist() == [True, False]


def test_an_unknown_column_is_refused(table):
    with pytest.raises(DexFlexError, match="no columns wind"):
        table.append([row(7, wind=1)])
    assert table.load().empty


def test_another_file_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "notes.csv"
    path.write_text("name,age\nada,36\n")
    with pytest.raises(DexFlexError, match="lacks the columns method, version"):
        Table(path, ["success"])
    assert path.read_text() == "name,age\nada,36\n"


def test_the_origin_of_a_version_is_noted_once(table):
    version = Version("code", "weights", "device=cpu")
    table.remember("raw", version)
    table.remember("raw", version)
    table.remember("raw", Version("other code"))
    origins = table.origins()
    assert origins["version"].tolist()[0] == version.name
    assert len(origins) == 2
    assert origins["settings"].fillna("").tolist() == ["device=cpu", ""]
