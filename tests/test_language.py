"""The words of the project: plain terms of the field, in code, messages and pages.

``python tests/test_language.py PATH ...`` prints what the tests would refuse.
"""

import ast
import io
import re
import sys
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "CITATION.cff",
    "docs",
    "paper",
    "src",
    "benchmarks",
]
SUFFIXES = {".md", ".cff", ".yaml", ".j2", ".html", ".js", ".py", ".toml"}
MAX_WORDS = 30

# The expression and what to write instead.
BANNED = {
    r"told|untold": "given, specified, reported",
    r"tells?|telling": "reports, specifies, distinguishes",
    r"so many|so often|so far off": "N, the number of",
    r"anew": "again, new",
    r"lest": "so that ... not",
    r"whatever|whoever|whichever|whence|thereby|therein|likewise": "the noun",
    r"such a one|taken at (its|their) word|its way|wrong by|farther off": "a plain statement",
    r"besides?": "next to, along with, in addition",
    r"(dis)?honest(y|ly)?|surer|sureness": "consistent, overconfident; confidence",
    r"(the|a) truth": "ground truth",
    r"stands|stood": "is in place, is static",
    r"judg(e|es|ed|ing|ements?)|verdicts?": "test, decide, decision",
    r"goods|crates?": "objects, landmarks",
    r"says?|said": "reports, specifies, indicates",
    r"knows|believes?|believed|supposes?|supposed": "assumes, estimates, uses",
    r"what (is|was|are|were|has|had|it|they|came|comes|stays|lies)": "the noun",
}
WORDS = re.compile(r"\b(" + "|".join(f"({word})" for word in BANNED) + r")\b", re.IGNORECASE)
NAME_PARTS = re.compile(
    r"(?i:(^|_)(told|untold|tells?|telling|anew|lest|besides?|verdict|judged?|(dis)?honest(y|ly)?"
    r"|stood|stands|says|knows)(_|$))"
    r"|(^|_)(fewest|most(?!_likely)|least(?!_squares)|farthest)_|^_?(FEWEST|MOST|LEAST|FARTHEST|LARGEST|SMALLEST)(_|$)"
)
# Part of a path -> the words that may stay there.
ALLOWED: dict[str, tuple[str, ...]] = {
    "homeward/places/version.py": ("stands",),
    "homeward/places/place.py": ("verdict",),  # a column of visits.csv
    "homeward/places/persistence.py": ("stands",),  # a column of landmarks.csv
    "docs/do/live.md": ("said",),  # a ROS topic
    "docs/do/ros.md": ("said",),  # a ROS topic
    "src/homeward/ros/": ("said",),
    "runs/report/place_page.py": ("verdict",),  # a column of visits.csv
    "docs/do/rooms.md": ("stood",),  # a key of rooms
    "benchmarks/fuzz.py": ("crate",),  # changes the cases of all seeds
    "benchmarks/places/": ("verdict",),
    "benchmarks/soak.py": ("said",),  # a ROS topic
    "docs/look-up/files.md": ("verdict",),
    "src/homeward/vision/report.py": ("verdict",),  # a column of matches.csv
    "lab/simulation/render/": ("stood",),  # a key of scenario.yaml
    "data/rooms/": ("stood",),
}


def sources(paths):
    for path in paths:
        path = Path(path)
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in SUFFIXES and "__pycache__" not in file.parts:
                yield file


def prose(file):
    """Yield the line number and the text of what people read in a file."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type in (tokenize.STRING, tokenize.COMMENT) or (
                tokenize.tok_name[token.type] == "FSTRING_MIDDLE"
            ):
                yield from enumerate(token.string.split("\n"), token.start[0])
    else:
        yield from enumerate(text.split("\n"), 1)


def names(file):
    """Yield the line number and each name that a Python file defines."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.lineno, node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg


def banned_words(paths):
    """Return the lines with a banned word, and the names that contain one."""
    found = []
    for file in sources(paths):
        where = file.resolve().relative_to(ROOT).as_posix()
        for number, line in prose(file):
            for match in WORDS.finditer(line):
                word = match.group(0)
                question = word.lower().startswith("what ") and "?" in line[match.end() :]
                if not question and not is_allowed(where, word):
                    found.append(f"{where}:{number}: {word!r} in: {line.strip()[:90]}")
        if file.suffix == ".py":
            for number, name in sorted(set(names(file))):
                if NAME_PARTS.search(name) and not is_allowed(where, name):
                    found.append(f"{where}:{number}: name {name}")
    return found


def is_allowed(where, word):
    return any(part in where and word.lower() in words for part, words in ALLOWED.items())


def long_sentences(paths):
    """Return the sentences of messages (strings that are no docstrings) that are too long."""
    found = []
    for file in sources(paths):
        if file.suffix != ".py":
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        docstrings = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        parts = {
            id(part)
            for node in ast.walk(tree)
            if isinstance(node, ast.JoinedStr)
            for part in ast.walk(node)
            if part is not node
        }
        for node in ast.walk(tree):
            if id(node) in docstrings or id(node) in parts:
                continue
            if isinstance(node, ast.JoinedStr):
                text = "".join(
                    part.value if isinstance(part, ast.Constant) else "X" for part in node.values
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
            else:
                continue
            for sentence in re.split(r"(?<=[.:;?!])\s+|\n", text):
                if len(sentence.split()) > MAX_WORDS:
                    where = file.resolve().relative_to(ROOT).as_posix()
                    found.append(f"{where}:{node.lineno}: {sentence[:100]} ...")
    return found


@pytest.mark.parametrize("page", PAGES)
def test_no_banned_word_is_written(page):
    found = banned_words([ROOT / page])
    assert not found, "\n".join(found)


def test_sentences_of_messages_are_short():
    found = long_sentences([ROOT / "src"])
    assert not found, "\n".join(found)


if __name__ == "__main__":
    sys.stdout.writelines(
        line + "\n" for line in banned_words(sys.argv[1:]) + long_sentences(sys.argv[1:])
    )
