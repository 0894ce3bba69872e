"""The documents say what the code does."""

import re
from pathlib import Path

import pytest

import protocol.config
import protocol.messages
from protocol.model import Message
from protocol.topics import TOPICS
from robot.slam.engines import ENGINES

ROOT = Path(__file__).resolve().parents[2]
PROTOCOL = (ROOT / "docs/protocol.md").read_text()
SCHEMAS = sorted(
    {topic.schema for topic in TOPICS if topic.schema is not None},
    key=lambda schema: schema.SCHEMA,
)
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_table_of_topics_is_that_of_the_code() -> None:
    rows = [line for line in PROTOCOL.splitlines() if line.startswith(("| `robot/", "| `world/"))]
    expected = []
    for topic in TOPICS:
        key = topic.key.replace("{robot}", "<name>")
        schema = f"{topic.schema.SCHEMA} {topic.schema.VERSION}" if topic.schema else "–"
        way = f"{topic.source} → {topic.target}"
        cells = [f"`{key}`", way, topic.style.value, schema, topic.keep, topic.rate]
        expected.append(f"| {' | '.join(cells)} |")
    assert rows == expected


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.SCHEMA)
def test_every_field_of_a_message_is_documented(schema: type[Message]) -> None:
    section = PROTOCOL.split(f"\n### {schema.SCHEMA}\n", 1)[1].split("\n#", 1)[0]
    named = [
        name
        for line in section.splitlines()
        if line.startswith("| `")
        for name in re.findall(r"`(\w+)`", line.split("|")[1])
    ]
    assert named == list(schema.model_fields)


def test_limits_in_the_protocol_are_those_of_the_code() -> None:
    assert f"{protocol.config.MAX_FRAME_BYTES:,}" in PROTOCOL
    assert f"{protocol.messages.FRAME_HEADER_BYTES} bytes of header" in PROTOCOL


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), target


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_files_that_are_named_exist(path: Path) -> None:
    rooms = "protocol|world|robot|station|studies|maps|deploy|docs"
    for name in re.findall(rf"`((?:{rooms})/[\w/-]+\.\w+)`", path.read_text()):
        assert (ROOT / name).exists(), name


def test_engines_in_the_readme_are_those_of_the_code() -> None:
    line = next(
        line for line in (ROOT / "README.md").read_text().splitlines() if "`--engine " in line
    )
    assert set(ENGINES) <= set(re.findall(r"[\w-]+", line))
