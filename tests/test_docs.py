"""What README and the site tell to type, and where they lead, must be right.

Commands are read by the program's own parser, which refuses options and commands that are not
there; snippets run in `test_readme`, and what they need of data or time is said there.
"""

import importlib.util
import re
import shlex
from pathlib import Path

import pytest
import typer
from typer.exceptions import TyperException

from homeward.cli.main import app
from homeward.cli.settings import OTHERS, other_model
from homeward.drives.landmarks import KnownLandmarks
from homeward.errors import InputError
from homeward.io.settings import parse_settings

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8")
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
}
COMMANDS = typer.main.get_command(app).commands


def typed(text):
    """Yield the lines of code blocks that a shell is to run, without comments."""
    for line in re.findall(r"^(?: {4}|\t)(.*)$", text, re.MULTILINE):
        try:
            words = shlex.split(line, comments=True)
        except ValueError:
            continue  # what a program printed
        if "&&" in words:
            words = words[words.index("&&") + 1 :]
        while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
            words = words[1:]
        if words:
            yield words


def complaint(words):
    """What the program's parser has against a command; nothing, if it takes it."""
    _, name, *rest = words
    if name not in COMMANDS:
        known = ("--help", "--install-completion", "-h")
        return "" if name in known else f"no command {name}"
    if {"-h", "--help"} & set(rest):
        return ""
    try:
        COMMANDS[name].make_context(name, rest)
    except TyperException as error:
        return error.format_message()
    return ""


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_blocks_are_what_the_program_takes(page):
    for words in typed(PAGES[page]):
        if words[0] == "homeward" and len(words) > 1:
            assert not complaint(words), (words, complaint(words))


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_sentences_exist_with_their_options(page):
    for line in re.findall(r"`(homeward [a-z][^`]*)`", PAGES[page]):
        words = [word.split("|")[0] for word in shlex.split(line.split("#")[0])]
        if "..." in words:
            words = [*words[: words.index("...")], "KEY=VALUE"]
        found = complaint(words)
        short = found.startswith("Missing") or "requires an argument" in found
        assert not found or short, (line, found)


@pytest.mark.parametrize("page", PAGES)
def test_programs_beside_homeward_exist(page):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for words in typed(PAGES[page]):
        match words:
            case ["python", "-m", module, *_]:
                assert importlib.util.find_spec(module), words
            case ["python", script, *_] if script.endswith(".py"):
                assert (ROOT / script).exists(), words
            case ["make", *targets]:
                for target in (t for t in targets if "=" not in t):
                    assert re.search(rf"^{target}:", makefile, re.MULTILINE), words


@pytest.mark.parametrize("page", PAGES)
def test_yaml_is_what_some_reader_takes(page):
    for text in re.findall(r"```yaml\n(.*?)```", PAGES[page], re.DOTALL):
        refusals = []
        for model in (KnownLandmarks, *map(other_model, OTHERS)):
            try:
                parse_settings(text, model, ROOT / page)
                break
            except InputError as error:
                refusals.append(str(error))
        else:
            raise AssertionError(refusals)


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files(page):
    """Links within the site are the site's own build to check; those of README are not."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", PAGES[page]):
        if not target.startswith("http"):
            assert ((ROOT / page).parent / target).exists(), target


TASKS = [page for page in PAGES if re.fullmatch(r"docs/do/(?!index)[\w-]+\.md", page)]


@pytest.mark.parametrize("page", TASKS)
def test_a_task_begins_with_its_command_and_ends_with_the_next_step(page):
    """Within the first 12 lines is a block to type, or Python; the last lines have a link."""
    lines = PAGES[page].rstrip().split("\n")
    assert any(line.startswith(("    ", "```python")) for line in lines[:12])
    assert re.search(r"\]\([^)]+\)", "\n".join(lines[-4:]))


@pytest.mark.parametrize(
    "term",
    [
        "ground truth",
        "extrinsics",
        "lever arm",
        "factor graph",
        "data association",
        "loop closure",
        "PnP",
        "robust kernel",
        "odometry drift",
        "kidnapped robot",
        "resection",
        "triangulation",
    ],
)
def test_a_search_for_a_term_of_the_field_finds_a_page(term):
    assert [page for page, text in PAGES.items() if term.lower() in text.lower()]


def test_every_page_with_python_is_run():
    run = (ROOT / "tests" / "test_readme.py").read_text(encoding="utf-8")
    elsewhere = {
        "do/studies.md": "lab/studies/test_study.py",
        "do/estimators.md": "test_plugins.py",
    }
    elsewhere["do/cameras.md"] = "vision/test_tags.py"
    elsewhere["do/extend.md"] = "test_extend.py"
    elsewhere["do/sources.md"] = "drives/test_sources.py"
    elsewhere["do/live.md"] = "live/test_live_client.py"
    elsewhere["do/known-landmarks.md"] = "drives/test_landmarks_yaml.py"
    for page, text in PAGES.items():
        if "```python" not in text:
            continue
        name = page.removeprefix("docs/")
        if name in elsewhere:
            assert Path(name).name in (ROOT / "tests" / elsewhere[name]).read_text("utf-8")
        elif not name.startswith("learn/"):  # all of which run
            assert name in run, page
