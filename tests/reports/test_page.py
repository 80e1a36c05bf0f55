"""The page: what stands in it, and how it behaves in a browser.

The browser is driven by the fragment of the page's address alone.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg.reports.figures import draw_figures
from nerfreg.reports.page import write_page
from nerfreg.reports.pictures import compare
from nerfreg.reports.records import NamedRun
from nerfreg.reports.sheet import draw_sheet
from nerfreg.reports.tables import Column, Row, Table, TableCell
from nerfreg.runs.records import EvaluationRecord

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))), None
)
PSNR, LPIPS = Column("PSNR", "dB", ".2f", "up"), Column("LPIPS", "", ".3f", "down")
TABLE = Table(
    title="fern, 3 views",
    name="fern-3",
    columns=(PSNR, LPIPS),
    # as text 9.5 comes after 18; not in order by any column
    rows=(
        Row("vanilla", (TableCell(18.0, 0.25, 3), TableCell(0.3, count=3, second=True)), 3),
        Row("entropy", (TableCell(None), TableCell(None, text="not reached")), 0),
        Row("combinerf", (TableCell(21.5, best=True), TableCell(0.2, best=True)), 1),
        Row("<b>odd</b> & kl", (TableCell(9.5), TableCell(0.4)), 1),
        Row("vanilla (paper)", (TableCell(17.79), TableCell(None)), paper=True),
    ),
    notes=("a note",),
)


def run(
    folder: Path, method: str, color: int, failure: str | None = None, seed: int = 0
) -> NamedRun:
    """A run of fern with pictures of two views, 8 x 12 pixels, or one that failed."""
    early = EvaluationRecord(100, 10.0, 15.0, None, None, 0.3, None, 2, False)
    late = EvaluationRecord(900, 90.0, 17.0, None, None, 0.2, None, 2, False)
    final = None if failure else EvaluationRecord(1000, 100.0, 18.0, 0.5, 0.3, 0.15, None, 3, True)
    folder.mkdir(parents=True)
    if final:
        panels = [np.full((8, 12, 3), value, np.uint8) for value in (color, color // 2, 128, 0)]
        for view in ("image000", "image008"):
            (folder / "renders").mkdir(exist_ok=True)
            iio.imwrite(folder / "renders" / f"{view}.png", np.concatenate(panels, axis=1))
        scores = {"image000": {"psnr": 17.0}, "image008": {"psnr": 19.0 + color / 100}}
        (folder / "results.json").write_text(json.dumps({"test_views": scores}))
    evaluations = (early, late) if final is None else (early, late, final)
    command = ("scene=llff", "scene.path=my data/fern", f"+reg=[{method}]", f"seed={seed}")
    settings = {} if method == "vanilla" else {f"reg.{method}.weight": 1.0}
    about = (folder, "fern", 3, False, seed, evaluations, final, settings, command)
    return NamedRun(*about, method=method, failure=failure)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    records = [
        run(folder / "runs" / "a", "vanilla", 100),
        run(folder / "runs" / "b", "combinerf", 120),
        run(
            folder / "runs" / "c",
            "kl",
            0,
            failure="step 3: <script>alert(1)</script> is not finite",
        ),
    ]
    return write(records, [TABLE], folder / "out")


def write(records: list[NamedRun], tables: list[Table], folder: Path) -> Path:
    compared, notes = compare(records)
    for view in compared:
        draw_sheet(view, folder / "pictures")
    figures = draw_figures(records, [], folder)
    return write_page(records, tables, figures, compared, notes, folder)


class Elements(HTMLParser):
    """Every start tag with its attributes, and the text of every table row, in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[str] = []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append("")
        self.inside = self.inside or tag == "tr"

    def handle_endtag(self, tag: str) -> None:
        self.inside = self.inside and tag != "tr"

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1] += data.replace("\n", " ")


def test_the_page_needs_nothing_else(report: Path) -> None:
    text = report.read_text()
    links = [
        value
        for _, attrs in Elements(text).tags
        for key in ("src", "href", "xlink:href")
        if (value := attrs.get(key))
    ]
    assert links and all(link.startswith(("data:", "#")) for link in links)
    assert "@import" not in text and "url(http" not in text
    assert len(text) < 15_000_000


def test_every_id_is_there_once_and_every_link_leads_somewhere(report: Path) -> None:
    tags = Elements(report.read_text()).tags
    ids = [attrs["id"] for _, attrs in tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    links = {
        str(value)[1:]
        for _, attrs in tags
        for key in ("href", "xlink:href")
        if str(value := attrs.get(key)).startswith("#")
    }
    assert links <= {*ids}


def test_what_comes_from_runs_is_text_and_not_markup(report: Path) -> None:
    text = report.read_text()
    assert (
        "<script>alert" not in text
        and "&lt;script&gt;alert(1)&lt;/script&gt; is not finite" in text
    )
    assert "<b>odd" not in text and "&lt;b&gt;odd&lt;/b&gt; &amp; kl" in text


def test_rows_say_what_the_table_says(report: Path) -> None:
    rows = [" ".join(row.split()) for row in Elements(report.read_text()).rows]
    assert rows[:6] == [
        "method PSNR dB LPIPS seeds",
        "vanilla 18.00 ± 0.25 0.300 3",
        "entropy n/a not reached 0",
        "combinerf 21.50 0.200 1",
        "<b>odd</b> & kl 9.50 0.400 1",
        "vanilla (paper) 17.79 n/a",
    ]


def test_the_best_the_second_and_the_papers_rows_are_marked(report: Path) -> None:
    tags = Elements(report.read_text()).tags
    cells = [attrs for tag, attrs in tags if tag == "td" and "data-value" in attrs]
    marked = {attrs["data-value"]: (attrs.get("class") or "").strip() for attrs in cells}
    assert (
        marked["21.5"] == marked["0.2"] == "best"
        and marked["0.3"] == "second"
        and marked["18.0"] == ""
    )
    assert sum(tag == "tr" and attrs.get("class") == "paper" for tag, attrs in tags) == 1


def test_commands_are_quoted_for_a_shell_and_failures_have_their_reasons(report: Path) -> None:
    text = report.read_text()
    words = "scene=llff 'scene.path=my data/fern' '+reg=[combinerf]' seed=0"
    assert f"nerfreg train {html.escape(words).replace('&#x27;', '&#39;')}" in text
    section = text[text.index('<section id="failed">') :]
    assert "kl, fern, 3 views, seed 0" in section and "is not finite" in section


def test_figures_and_pictures_of_every_kind_are_on_the_page(report: Path) -> None:
    tags = Elements(report.read_text()).tags
    plots = [attrs["class"] for tag, attrs in tags if tag == "figure"]
    assert plots == ["plot curves", "plot pareto"]
    shown = [
        (attrs["data-method"], attrs["data-kind"])
        for tag, attrs in tags
        if tag == "img" and "data-view" in attrs
    ]
    kinds = [
        (method, kind)
        for method in ("vanilla", "combinerf")
        for kind in ("colour", "error", "depth")
    ]
    assert shown == 2 * [("photograph", "colour"), *kinds]
    sheets = sorted(path.name for path in (report.parent / "pictures").iterdir())
    assert sheets == ["fern-3-image000.png", "fern-3-image008.png"]


def test_the_same_runs_give_the_same_page(report: Path, tmp_path: Path) -> None:
    records = [run(tmp_path / "a", "vanilla", 100)]
    pages = [write(records, [TABLE], tmp_path / name).read_bytes() for name in ("one", "two")]
    assert pages[0] == pages[1]


def test_without_runs_that_are_scored_there_is_still_a_page(tmp_path: Path) -> None:
    record = run(tmp_path / "a", "vanilla", 0, failure="out of memory")
    text = write([record], [], tmp_path / "out").read_text()
    assert (
        "out of memory" in text
        and '<section id="compare"' not in text
        and '<section id="tables">' not in text
    )


# In a browser.


Browse = Callable[..., str]


@pytest.fixture
def browse(report: Path, tmp_path: Path) -> Browse:
    """The document after its scripts have run with a fragment; fails on anything in the console."""
    if BROWSER is None:
        pytest.skip("no chromium, google-chrome or chromium-browser on PATH to try the page in")

    def browse(fragment: str = "", actions: str = "") -> str:
        """actions: a script that is run after those of the page."""
        tried = tmp_path / "tried.html"
        tried.write_text(
            report.read_text().replace("</body>", f"<script>{actions}</script></body>")
        )
        command = [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--no-first-run", "--disable-background-networking", "--enable-logging=stderr", "--v=0",
            f"--user-data-dir={tmp_path}/profile", "--virtual-time-budget=2000", "--dump-dom",
            f"file://{tried}{fragment}",
        ]  # fmt: skip
        environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
        assert done.returncode == 0, done.stderr
        assert "CONSOLE" not in done.stderr, done.stderr
        return done.stdout

    return browse


def order(document: str) -> list[str]:
    names = [
        html.unescape(name)
        for name in re.findall(r'<th scope="row" data-text="([^"]+)">', document)
    ]
    return ["odd" if "odd" in name else name for name in names]


def test_a_browser_shows_the_table_in_its_own_order_first(browse: Browse) -> None:
    document = browse("#tables")  # a link to a section is no state
    assert order(document) == ["vanilla", "entropy", "combinerf", "odd", "vanilla (paper)"]
    assert "<th aria-sort" not in document and not re.search(r"<th [^>]*aria-sort", document)
    assert 'class="script"' in document  # and with it what needs scripts is shown
    assert "--split: 50%" in document


@pytest.mark.parametrize(
    ("fragment", "expected", "direction"),
    [
        # the best first, by number and not by letter (9.50 after 18.00); what is n/a last
        ("#sort=psnr", ["combinerf", "vanilla", "vanilla (paper)", "odd", "entropy"], "descending"),
        # what is n/a stays last the other way round
        (
            "#sort=psnr&order=up",
            ["odd", "vanilla (paper)", "vanilla", "combinerf", "entropy"],
            "ascending",
        ),
        # lower is better; of those that are n/a the first stays first
        ("#sort=lpips", ["combinerf", "vanilla", "odd", "entropy", "vanilla (paper)"], "ascending"),
    ],
)
def test_a_browser_sorts_by_the_fragment(
    browse: Browse, fragment: str, expected: list[str], direction: str
) -> None:
    document = browse(fragment)
    assert order(document) == expected
    (head,) = re.findall(r"<th [^>]*aria-sort[^>]*>", document)
    assert (
        f'aria-sort="{direction}"' in head and f'data-column="{fragment[6:].split("&")[0]}"' in head
    )


def test_a_browser_shows_the_two_methods_of_the_fragment(browse: Browse) -> None:
    document = browse("#view=fern-3/image008&left=combinerf&right=photograph&show=depth&split=30")
    slider = re.search(r'<div class="slider".*?</div>', document, re.DOTALL)[0]
    assert "--split: 30%" in slider
    sources = dict(re.findall(r'<img class="(left|right)" alt="[^"]*" src="([^"]+)"', slider))
    pictures = [
        attrs
        for tag, attrs in Elements(document).tags
        if tag == "img" and attrs.get("data-view") == "fern-3/image008"
    ]
    by_name = {(attrs["data-method"], attrs["data-kind"]): attrs["src"] for attrs in pictures}
    assert sources["left"] == by_name["combinerf", "depth"]
    assert sources["right"] == by_name["photograph", "colour"], "a photograph has no depth"


def test_a_browser_ignores_what_it_does_not_know(browse: Browse) -> None:
    document = browse("#sort=nothing&view=none&left=nobody&split=1000&show=x&order=sideways")
    assert order(document)[0] == "vanilla" and "--split: 50%" in document
    assert 'class="tag left" aria-hidden="true">vanilla<' in document
    assert 'class="tag right" aria-hidden="true">combinerf<' in document


def test_what_a_reader_does_is_seen_and_stands_in_the_fragment(browse: Browse) -> None:
    actions = """
      const head = () => document.querySelector("[data-column=lpips] button");
      head().click(); head().click();
      const set = (name, value, ...events) => {
        const input = document.querySelector(`[name=${name}]`);
        input.value = value;
        for (const event of events) input.dispatchEvent(new Event(event));
      };
      set("split", 12, "input", "change");
      set("view", "fern-3/image008", "change");
      set("left", "photograph", "change");
      document.title = location.hash;
    """
    document = browse("", actions)
    assert order(document) == ["odd", "vanilla", "combinerf", "entropy", "vanilla (paper)"]
    assert (
        "--split: 12%" in document and 'class="tag left" aria-hidden="true">photograph<' in document
    )
    title = html.unescape(re.findall("<title>(.*?)</title>", document)[0])
    assert title == "#sort=lpips&order=down&split=12&view=fern-3%2Fimage008&left=photograph"


def test_the_console_is_watched(browse: Browse) -> None:
    with pytest.raises(AssertionError, match="no such thing"):
        browse("", "throw new Error('no such thing')")


def test_the_page_may_not_use_the_network(browse: Browse) -> None:
    with pytest.raises(AssertionError, match="Content Security Policy"):
        browse(
            "",
            "document.body.append(Object.assign(new Image(), { src: 'http://127.0.0.1:9/a.png' }))",
        )
