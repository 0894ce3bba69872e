"""The team: what a robot knows as a journal, how journals meet, and the one map they make."""
