#!/bin/sh
# World and three robots on the shipped office, from a fresh clone to a report.
# Options are those of `earshot run`: deploy/run.sh --robots 2 --map loop --range 6
set -eu
cd "$(dirname "$0")/.."
. deploy/setup.sh

prepare "$RUN_LOCK"
"$python" -m station.main warm-up
say "running: earshot run $*"
# In place of this shell: Ctrl-C reaches the run itself, which ends its robots before it ends.
exec "$python" -m station.main run "$@"
