import base64
import re
from html.parser import HTMLParser

import pytest
from evaluation_fakes import NAMESPACE, TASKS, FakePlayers

from lerobot_dexflex.evaluation.comparison import Comparison, compare
from lerobot_dexflex.evaluation.report.page import write_report

PNG, MP4 = b"\x89PNG\r\n\x1a\n", b"ftyp"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "out"
    comparison = Comparison(
        {TASKS[0]: FakePlayers()},
        ("good", "lucky"),
        out,
        seeds=range(100_000, 100_004),
        videos=2,
        rerun=True,
        namespace=NAMESPACE,
    )
    write_report(comparison, compare(comparison, workers=0, quiet=True))
    return out


class Sources(HTMLParser):
    """Collects what the page shows and what it would load."""

    def __init__(self):
        super().__init__()
        self.images, self.videos, self.links, self.text = [], [], [], []

    def handle_starttag(self, tag, attrs):
        for key, value in attrs:
            if key == "src":
                (self.videos if tag == "video" else self.images).append(value)
            elif key in ("href", "srcset", "action", "poster"):
                self.links.append(value)

    def handle_data(self, data):
        self.text.append(data)


def parse(folder):
    page = Sources()
    page.feed((folder / "report.html").read_text())
    return page


def decode(source):
    return base64.b64decode(source.split(",", 1)[1])


def test_three_figures_and_the_interventions_of_filmed_episodes_are_inside(folder):
    images = [decode(source) for source in parse(folder).images]
    assert len(images) == 3 + 2
    assert all(image.startswith(PNG) for image in images)
    assert len(set(images)) == 3 + 2


def test_filmed_episodes_are_inside_and_play_in_a_browser(folder):
    videos = [decode(source) for source in parse(folder).videos]
    assert len(videos) == 2
    assert all(MP4 in video[:16] and b"avc1" in video for video in videos)


def test_nothing_is_loaded_from_elsewhere(folder):
    page = parse(folder)
    assert page.links == []
    assert all(source.startswith("data:") for source in page.images + page.videos)
    outside_data = re.sub(r"base64,[A-Za-z0-9+/=]+", "", (folder / "report.html").read_text())
    assert not re.search(r"https?:|//[a-z]|@import|url\(", outside_data)


def test_page_and_markdown_show_the_same_numbers(folder):
    text = " ".join(parse(folder).text)
    table = (folder / "comparison.md").read_text()
    for number in ("4/4 (100 %)", "51-100 %", "2/4 (50 %)", "15-85 %"):
        assert number in table
        assert number in text


def test_the_page_says_how_it_was_made(folder):
    text = " ".join(parse(folder).text)
    assert "weights a" in text
    assert "commit" in text


def test_recordings_for_rerun_are_written_when_asked(folder):
    recordings = sorted(folder.glob("rerun/Count-v0/clean/*"))
    assert [file.name for file in recordings] == [
        f"{seed}_{method}.rrd" for seed in (100_000, 100_001) for method in ("good", "lucky")
    ]
    assert all(file.read_bytes()[:4] == b"RRF2" for file in recordings)
