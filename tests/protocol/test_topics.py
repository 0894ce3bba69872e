import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.topics import ACT, SENSE, TOPICS, WORLD_ALIVE, Style

NAMES = st.from_regex(r"[a-z][a-z0-9_-]{0,31}", fullmatch=True)


def test_names_and_keys_differ() -> None:
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    assert len({(topic.key, topic.style) for topic in TOPICS}) == len(TOPICS)


def test_what_concerns_a_robot_lies_under_its_own_key() -> None:
    for topic in TOPICS:
        if "robot" in (topic.source, topic.target) and topic is not WORLD_ALIVE:
            assert topic.key.startswith("robot/{robot}/")


def test_every_topic_but_presence_has_a_schema() -> None:
    for topic in TOPICS:
        assert (topic.schema is None) == (topic.style is Style.PRESENCE)


@given(NAMES)
def test_keys_of_different_robots_never_meet(name: str) -> None:
    for topic in TOPICS:
        if "{robot}" in topic.key:
            assert topic.key_for(name).split("/")[1] == name
            assert re.fullmatch(r"[a-z0-9_/-]+", topic.key_for(name))


def test_a_key_takes_a_name_exactly_when_it_has_a_place_for_it() -> None:
    assert SENSE.key_for("r1") == "robot/r1/sense"
    with pytest.raises(ValueError, match="needs a robot name"):
        ACT.key_for()
    with pytest.raises(ValueError, match="takes no robot name"):
        WORLD_ALIVE.key_for("r1")
