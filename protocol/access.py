"""Who may touch which key: the router's access control, read off the table of topics.

A robot may do what the table has it do on the keys under its own name, and nothing else; so may
the station. Everything that is not a row of the table is refused, put or declared by whom ever.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

from protocol.topics import TOPICS, WORLD_ALIVE, Style, Topic

STATION_USER = "@station"
"""The operator's user name; no robot can have it, since names of robots start with a letter."""

# What goes to the router (ingress) and comes from it (egress), by the messages' names in Zenoh.
# A publisher sends only what it knows to be wanted: it has to see the subscription to its key.
_SPEAKING = {
    Style.PUBLISH: (("put",), ("declare_subscriber",)),
    Style.QUERY: (("declare_queryable", "reply"), ("query",)),
    Style.PRESENCE: (("liveliness_token",), ()),
}
_LISTENING = {
    Style.PUBLISH: (("declare_subscriber",), ("put",)),
    Style.QUERY: (("query",), ("declare_queryable", "reply")),
    Style.PRESENCE: (
        ("declare_liveliness_subscriber", "liveliness_query"),
        ("liveliness_token",),
    ),
}


def access_control(names: Sequence[str], namespace: str) -> dict[str, Any]:
    """Zenoh's `access_control` for a router with these robots: all is denied but what is listed."""
    rules = {name: list(_robot_rules(name, namespace)) for name in names}
    rules[STATION_USER] = list(_station_rules(names, namespace))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for rules_of_one in rules.values() for rule in rules_of_one],
        "subjects": [{"id": user, "usernames": [user]} for user in rules],
        "policies": [
            {"subjects": [user], "rules": [rule["id"] for rule in rules_of_one]}
            for user, rules_of_one in rules.items()
        ],
    }


def _robot_rules(name: str, namespace: str) -> Iterator[dict[str, Any]]:
    for topic in TOPICS:
        key = f"{namespace}/{_key(topic, name)}"
        if topic.source == "robot":
            yield from _both_ways(name, topic, [key], _SPEAKING[topic.style])
        elif topic.target == "robot":
            yield from _both_ways(name, topic, [key], _LISTENING[topic.style])


def _station_rules(names: Sequence[str], namespace: str) -> Iterator[dict[str, Any]]:
    for topic in TOPICS:
        if topic.target == "station" or topic is WORLD_ALIVE:
            keys = sorted({f"{namespace}/{_key(topic, name)}" for name in names})
            yield from _both_ways(STATION_USER, topic, keys, _LISTENING[topic.style])


def _key(topic: Topic, name: str) -> str:
    return topic.key_for(name if "{robot}" in topic.key else "")


def _both_ways(
    user: str, topic: Topic, keys: list[str], messages: tuple[tuple[str, ...], tuple[str, ...]]
) -> Iterator[dict[str, Any]]:
    flows: tuple[Literal["ingress", "egress"], ...] = ("ingress", "egress")
    for flow, allowed in zip(flows, messages, strict=True):
        if allowed:
            yield {
                "id": f"{user} {topic.name} {flow}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(allowed),
                "key_exprs": keys,
            }
