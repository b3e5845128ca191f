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


def measured(page, drawings, folder, *, widths, dark=False):
    """What a page shows at some widths [px], and its drawings by themselves.

    Skips where there is no Chromium.
    """
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip(f"needs Chromium: none of {', '.join(_NAMES)} is on the PATH")
    text = html.escape(page.read_text(encoding="utf-8"))
    frames = [
        f'<iframe width={width} height=30000 frameborder=0 srcdoc="{text}"></iframe>'
        for width in widths
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
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    options += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000"]
    options += ["--blink-settings=preferredColorScheme=0"] if dark else []
    done = subprocess.run(
        [program, *options, "--dump-dom", harness.as_uri()],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=True,
    )
    found = re.search('<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stdout[:500] + done.stderr[-500:]
    return json.loads(html.unescape(found[1]))
