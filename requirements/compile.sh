#!/bin/sh
# Writes all hashed locks anew; a locked version stays unless it no longer fits.
#   requirements/compile.sh             keep versions where possible
#   requirements/compile.sh --upgrade   take the newest of everything
set -eu
cd "$(dirname "$0")/.."

# compile LOCK SOURCE [OPTION ...]
compile() {
    lock="requirements/$1.txt"
    shift
    .uv/bin/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header \
        --python-version 3.11 "$@" -o "$lock"
}

compile gateway pyproject.toml "$@"
compile ros pyproject.toml --extra ros --extra simulate "$@"
compile dev pyproject.toml --extra ros --extra simulate --extra dev "$@"
printf 'pyinstaller>=6.16\ncyclonedx-python-lib>=11\n' | compile freeze pyproject.toml - --extra simulate "$@"
compile colcon requirements/colcon.in "$@"
echo 'uv>=0.9' | compile uv - "$@"
