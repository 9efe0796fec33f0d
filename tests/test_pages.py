"""What the pages tell readers to type: every `stair-env` line parses, and the first flights fly."""

import re
import shlex
from pathlib import Path

import pytest

from stair_env_cli import main as cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def commands():
    for page in PAGES:
        for block in blocks(page, r"(?:bash|sh|console|)"):
            for line in block.replace("\\\n", " ").splitlines():
                if not line.startswith("stair-env "):
                    continue
                words = shlex.split(line, comments=True)
                if "..." not in words:
                    yield pytest.param(words[1:], id=f"{page.stem}: {' '.join(words)}")


@pytest.mark.parametrize("words", list(commands()))
def test_commands_of_the_pages_parse(words):
    parser = cli._build_parser(words[0], cli._import_command(words[0]))
    assert parser.parse_args(words).command == words[0]


def test_first_flights_fly(capsys):
    names = {}
    for block in blocks(ROOT / "docs" / "start" / "first_flight.md", "python"):
        exec(block, names)
    assert names["info"]["termination"] == "success"
    assert capsys.readouterr().out
