# Sourced by run.sh and test.sh, from the root of the clone: a virtual environment in .venv with
# exactly the locked packages, made once and used again while the lock is the same.

RUN_LOCK=deploy/requirements.lock
TEST_LOCK=deploy/requirements-dev.lock

say() { printf '%s\n' "$*"; }
fail() { printf '%s\n' "$*" >&2; exit 2; }

find_python() {
    for candidate in "${PYTHON:-}" python3.11 python3.12 python3.13 python3; do
        [ -n "$candidate" ] || continue
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    return 1
}

# prepare LOCK: after it, $python is the environment's interpreter.
prepare() {
    lock=$1
    base=$(find_python) || fail "Python 3.11 or newer is needed: sudo apt-get install python3 python3-venv"
    python=.venv/bin/python
    stamp=.venv/installed
    if [ -x "$python" ] && grep -qxF "$(key_of "$lock")" "$stamp" 2>/dev/null; then
        return 0
    fi
    "$base" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "$base has no venv: sudo apt-get install $(venv_package "$base")"
    say "installing the locked packages into .venv (once, about a minute)"
    [ -x "$python" ] && "$python" -c 'import pip' 2>/dev/null || "$base" -m venv --clear .venv
    rm -f "$stamp"
    "$python" -m pip install --quiet --disable-pip-version-check --require-hashes -r "$lock" ||
        fail "the packages could not be installed; is the network there?"
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps \
        --no-build-isolation --editable . || fail "Earshot itself could not be installed"
    key_of "$lock" >"$stamp.part"
    # What run.sh needs is part of what test.sh needs.
    [ "$lock" = "$RUN_LOCK" ] || key_of "$RUN_LOCK" >>"$stamp.part"
    mv "$stamp.part" "$stamp"
}

# key_of LOCK: what an environment is good for, the lock's content and the place of the clone.
key_of() {
    { cat "$1" pyproject.toml; pwd -P; } | cksum
}

venv_package() {
    "$1" -c 'import sys; print(f"python3.{sys.version_info.minor}-venv")' 2>/dev/null
}
