"""A page on a studio of its own, in Chromium."""

import contextlib
import subprocess
import sys

from runs.browser import Page


@contextlib.contextmanager
def studio(scratch, *words, **options):
    """A page on a studio of its own."""
    command = [sys.executable, "-m", "homeward", "studio", *words, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = process.stdout.readline().split()[-1]
            page = Page(scratch, address, **options)
            try:
                page.until("window.studio && studio.frame")
                yield page
                assert page.errors == []
                wide = page.find("[document.documentElement.scrollWidth, innerWidth]")
                assert wide[0] <= wide[1]
            finally:
                page.close()
        finally:
            process.terminate()
            process.wait(timeout=20)
