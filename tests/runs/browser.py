"""Chromium without a window: opens a page, runs a script in it, and returns its findings."""

import json
import re
import shutil
import subprocess
from urllib.parse import unquote

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH")

_WATCH = """<script>
window.found = {wrong: []};
addEventListener("error", (e) => found.wrong.push(e.message));
addEventListener("unhandledrejection", (e) => found.wrong.push(String(e.reason)));
addEventListener("securitypolicyviolation", (e) => found.wrong.push(e.violatedDirective));
for (const level of ["error", "warn"]) {
  console[level] = (...said) => found.wrong.push(said.join(" "));
}
window.frame = () => new Promise((resolve) => setTimeout(resolve, 120));
(async () => {
  const page = document.documentElement;
  await new Promise((resolve) => addEventListener("load", resolve));
  while (page.dataset.drawn === undefined && found.wrong.length === 0) await frame();
  try { await (async () => { %s })(); } catch (e) { found.wrong.push(String(e)); }
  const out = document.createElement("pre");
  out.id = "found";
  out.textContent = encodeURIComponent(JSON.stringify(found));
  document.body.append(out);
})();
</script>"""


def open_page(file, script, scratch, width=1000, height=900, dark=False, address="", beside=False):
    """Return what `script` put into `found`, and under ``wrong`` every error and warning.

    The page is `width` by `height` px; `address` is what follows its name, as in "#t=3". A page
    that has files of its own is opened `beside` them.
    """
    html = file.read_text(encoding="utf-8")
    if 'id="data"' not in html:  # no script that reports when all is drawn
        html = html.replace("<html", '<html data-drawn=""', 1)
        html = html.replace(
            "default-src 'none';", "default-src 'none'; script-src 'unsafe-inline';"
        )
    probed = (file.parent if beside else scratch) / f"probed-{width}.html"
    before = "<style>" if "<style>" in html else "</head>"
    probed.write_text(html.replace(before, (_WATCH % script) + before, 1), encoding="utf-8")
    done = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={scratch / 'profile'}",
            f"--window-size={width},{height}",
            f"--blink-settings=preferredColorScheme={0 if dark else 1}",
            "--virtual-time-budget=20000",
            "--dump-dom",
            probed.as_uri() + address,
        ],
        capture_output=True,
        timeout=120,
        check=True,
    )
    found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout.decode())
    assert found, "the page did not get to its end"
    return json.loads(unquote(found[1]))
