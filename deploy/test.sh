#!/bin/sh
# All checks and tests, from a fresh clone; --all adds the slow statistical ones.
# Further arguments go to pytest: deploy/test.sh tests/world -k lidar
set -eu
cd "$(dirname "$0")/.."
. deploy/setup.sh

case "${1:-}" in
-h | --help)
    sed -n '2,3s/^# //p' "$0"
    exit 0
    ;;
esac
marks='not slow'
if [ "${1:-}" = --all ]; then
    marks=''
    shift
fi

prepare "$TEST_LOCK"
say "ruff"
"$python" -m ruff check .
"$python" -m ruff format --check .
say "mypy"
"$python" -m mypy
say "import walls"
"$python" -c 'from importlinter.cli import lint_imports_command; lint_imports_command()'
"$python" -m station.main warm-up
say "tests"
# As many as there are cores here, at most two: several tests start a whole team each.
exec "$python" -m pytest -n 2 --dist loadgroup -m "$marks" "$@"
