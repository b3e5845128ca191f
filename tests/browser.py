"""A page as a real browser lays it out, by Chromium's own command line."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_MEASURES = Path(__file__).with_name("measure_page.js")
WIDTHS = (400, 800, 1280)
"""Of a telephone, a tablet and a screen [px]."""
A4 = (595, 842)
"""In points."""
A4_PIXELS = 687
"""Between margins of 14 mm."""


def measured(page, drawings, folder, *, widths, dark=False):
    """What a page shows at some widths [px] and then as it is printed, and its drawings.

    Skips where there is no Chromium.
    """
    text = page.read_text(encoding="utf-8")
    on_paper = re.sub(r"@media screen and \([^)]*\)", "@media (max-width: 0)", text)
    on_paper = on_paper.replace("@media print", "@media all")
    frames = [
        f'<iframe width={width} height=30000 frameborder=0 srcdoc="{html.escape(shown)}"></iframe>'
        for shown, width in [*((text, width) for width in widths), (on_paper, A4_PIXELS)]
    ]
    inline = [
        # What comes before the drawing is not for a page.
        f'<div class=drawing id="{d.stem}"><svg{d.read_text("utf-8").partition("<svg")[2]}</div>'
        for d in drawings
    ]
    script = f"<script>{_MEASURES.read_text(encoding='utf-8')}</script>"
    harness = folder / "harness.html"
    harness.write_text(
        f"<!doctype html><meta charset=utf-8>{''.join(frames + inline)}{script}", encoding="utf-8"
    )
    more = ["--virtual-time-budget=20000", "--dump-dom"]
    more += ["--blink-settings=preferredColorScheme=0"] if dark else []
    done = _chromium(folder, *more, harness.as_uri())
    found = re.search('<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stdout[:500] + done.stderr[-500:]
    return json.loads(html.unescape(found[1]))


def assert_laid_out(page, drawings, folder):
    """Nothing cut, nothing on top of each other, on every screen and on paper."""
    found = measured(page, drawings, folder, widths=WIDTHS)
    assert [one["width"] for one in found["pages"]] == [*WIDTHS, A4_PIXELS]
    # On a telephone every row is a list; on paper it is a row.
    assert [one["headed"] for one in found["pages"]] == [False, True, True, True]
    for one in found["pages"]:
        assert not one["scrolls"], one["width"]
        assert one["outside"] == [], one["width"]
        assert one["overlapping"] == [], one["width"]
        assert len(one["figures"]) == len(drawings)
        for figure in one["figures"]:
            assert figure["drawn"]
            assert len(figure["caption"]) > 30
            assert len(figure["alt"]) > 20
            assert figure["alt"] not in figure["caption"]
    for one in found["drawings"]:
        assert one["n_texts"] > 3, one["name"]
        assert one["overlapping"] == [], one["name"]
        assert one["cut"] == [], one["name"]
    printed = sheets(page, folder)
    assert len(printed) > 1
    assert set(printed) == {A4}


def sheets(page, folder):
    """Width and height [points] of every sheet that a page is printed on."""
    printed = folder / "printed.pdf"
    _chromium(folder, "--no-pdf-header-footer", f"--print-to-pdf={printed}", page.as_uri())
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed.read_bytes())
    return [(round(float(width)), round(float(height))) for width, height in boxes]


def _chromium(folder, *arguments):
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip(f"needs Chromium: none of {', '.join(_NAMES)} is on the PATH")
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    return subprocess.run(
        [program, *options, f"--user-data-dir={folder / 'profile'}", *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=True,
    )
